// Following jobs: who wants to know is told of every change, in order.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "server/store/job.h"

namespace strata::server {

/// A job as a change has left it; `sequence` orders them. Null: none.
using JobEvent = std::shared_ptr<const Job>;

/// One follower of one job. Threads: any.
class JobSubscription {
 public:
  /// At most that many events wait; of a follower who is slower, runs of progress are thinned to
  /// their latest. Changes of state are kept.
  static constexpr std::size_t kMaxWaiting = 64;

  /// `on_event` is called after an event came, with locks held: it may only wake somebody up.
  /// Events up to the change number `after` are not news, but for the one that finishes the job.
  explicit JobSubscription(std::function<void()> on_event, std::uint64_t after = 0)
      : on_event_(std::move(on_event)), seen_(after) {}

  /// The next event, waiting for it up to `timeout` (0: not at all). Nothing when none came, or
  /// when the last one has been given out: see ended.
  JobEvent Next(Milliseconds timeout);
  /// Whether the event that finished the job was given out.
  bool ended() const;

 private:
  friend class JobEvents;
  void Push(const JobEvent& event);
  bool Wants(std::uint64_t sequence) const;

  mutable std::mutex mutex_;
  std::condition_variable came_;
  std::deque<JobEvent> waiting_;
  bool ended_ = false, finished_ = false;  // Given out; come.
  std::function<void()> on_event_;
  std::uint64_t seen_;
};

/// The followers of all jobs. Threads: any. An event that is older than one that was published
/// before is dropped.
class JobEvents {
 public:
  /// Events from the next Publish on.
  std::shared_ptr<JobSubscription> Subscribe(const std::string& id, std::function<void()> on_event,
                                             std::uint64_t after);
  /// To one follower alone: what it is to begin with.
  void Tell(JobSubscription& follower, const JobEvent& event) { follower.Push(event); }
  void Publish(const JobEvent& event);
  /// Whether change number `sequence` of the job would be news to a follower.
  bool Wants(const std::string& id, std::uint64_t sequence);
  /// The jobs that somebody follows.
  std::vector<std::string> Followed();

 private:
  std::mutex mutex_;
  std::unordered_map<std::string, std::vector<std::weak_ptr<JobSubscription>>> followers_;
};

}  // namespace strata::server
