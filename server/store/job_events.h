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
  explicit JobSubscription(std::function<void()> on_event) : on_event_(std::move(on_event)) {}

  /// The next event, waiting for it up to `timeout` (0: not at all). Nothing when none came, or
  /// when the last one has been given out: see ended.
  JobEvent Next(Milliseconds timeout);
  /// Whether the event that finished the job was given out.
  bool ended() const;

 private:
  friend class JobEvents;
  void Push(const JobEvent& event);

  mutable std::mutex mutex_;
  std::condition_variable came_;
  std::deque<JobEvent> waiting_;
  bool ended_ = false;
  std::function<void()> on_event_;
};

/// The followers of all jobs. Threads: any; who publishes keeps the order of a job's events.
class JobEvents {
 public:
  /// Events from the next Publish on; `first`, unless null, comes before them.
  std::shared_ptr<JobSubscription> Subscribe(const std::string& id, std::function<void()> on_event,
                                             const JobEvent& first);
  void Publish(const JobEvent& event);

 private:
  std::mutex mutex_;
  std::unordered_map<std::string, std::vector<std::weak_ptr<JobSubscription>>> followers_;
};

}  // namespace strata::server
