#include "server/store/job_events.h"

#include <algorithm>
#include <utility>

namespace strata::server {

JobEvent JobSubscription::Next(Milliseconds timeout) {
  std::unique_lock lock(mutex_);
  came_.wait_for(lock, timeout, [this] { return ended_ || !waiting_.empty(); });
  if (waiting_.empty()) return nullptr;
  JobEvent event = std::move(waiting_.front());
  waiting_.pop_front();
  ended_ = IsFinished(event->state);
  return event;
}

bool JobSubscription::ended() const {
  const std::lock_guard lock(mutex_);
  return ended_;
}

void JobSubscription::Push(const JobEvent& event) {
  {
    const std::lock_guard lock(mutex_);
    const bool finishes = IsFinished(event->state);
    if (finished_ || (event->sequence <= seen_ && !finishes)) return;
    seen_ = std::max(seen_, event->sequence);
    finished_ = finishes;
    const bool full = waiting_.size() >= kMaxWaiting;
    if (full && waiting_.back()->state == event->state) waiting_.pop_back();
    waiting_.push_back(event);
  }
  came_.notify_all();
  if (on_event_) on_event_();
}

bool JobSubscription::Wants(std::uint64_t sequence) const {
  const std::lock_guard lock(mutex_);
  return !finished_ && sequence > seen_;
}

std::shared_ptr<JobSubscription> JobEvents::Subscribe(const std::string& id,
                                                      std::function<void()> on_event,
                                                      std::uint64_t after) {
  auto subscription = std::make_shared<JobSubscription>(std::move(on_event), after);
  const std::lock_guard lock(mutex_);
  auto& of_job = followers_[id];
  std::erase_if(of_job, [](const auto& follower) { return follower.expired(); });
  of_job.push_back(subscription);
  return subscription;
}

bool JobEvents::Wants(const std::string& id, std::uint64_t sequence) {
  const std::lock_guard lock(mutex_);
  const auto found = followers_.find(id);
  if (found == followers_.end()) return false;
  for (const auto& follower : found->second) {
    const auto living = follower.lock();
    if (living && living->Wants(sequence)) return true;
  }
  return false;
}

std::vector<std::string> JobEvents::Followed() {
  std::vector<std::string> ids;
  const std::lock_guard lock(mutex_);
  std::erase_if(followers_, [](const auto& entry) {
    return std::ranges::all_of(entry.second,
                               [](const auto& follower) { return follower.expired(); });
  });
  for (const auto& [id, followers] : followers_) ids.push_back(id);
  return ids;
}

void JobEvents::Publish(const JobEvent& event) {
  std::vector<std::shared_ptr<JobSubscription>> told;
  {
    const std::lock_guard lock(mutex_);
    const auto found = followers_.find(event->id);
    if (found == followers_.end()) return;
    std::erase_if(found->second, [](const auto& follower) { return follower.expired(); });
    for (const auto& follower : found->second) {
      if (auto living = follower.lock()) told.push_back(std::move(living));
    }
    if (IsFinished(event->state) || told.empty()) followers_.erase(found);
  }
  for (const auto& follower : told) follower->Push(event);
}

}  // namespace strata::server
