#include "server/batch/schedule.h"

#include <utility>

namespace strata::server {

Schedule::Schedule(std::vector<BatchTask> tasks) {
  for (BatchTask& task : tasks) {
    (task.whole_machine ? large_ : small_).push_back(std::move(task));
  }
}

std::optional<BatchTask> Schedule::Pop(std::deque<BatchTask>& queue) {
  BatchTask task = std::move(queue.front());
  queue.pop_front();
  ++running_;
  exclusive_ = task.whole_machine;
  return task;
}

std::optional<BatchTask> Schedule::Take() {
  std::unique_lock lock(mutex_);
  while (!stopped_) {
    const bool wants_all = !large_.empty() || (small_.empty() && !again_.empty());
    if (!exclusive_ && wants_all && Free()) return Pop(large_.empty() ? again_ : large_);
    if (!exclusive_ && large_.empty() && !small_.empty()) return Pop(small_);
    if (Free() && !wants_all) return std::nullopt;
    changed_.wait(lock);
  }
  return std::nullopt;
}

void Schedule::Release(const BatchTask& task) {
  --running_;
  if (task.whole_machine) exclusive_ = false;
  changed_.notify_all();
}

void Schedule::End(const BatchTask& task) {
  const std::lock_guard lock(mutex_);
  Release(task);
}

void Schedule::Retry(BatchTask task) {
  const std::lock_guard lock(mutex_);
  Release(task);
  ++task.attempt;
  task.whole_machine = true;
  again_.push_back(std::move(task));
}

void Schedule::Stop() {
  const std::lock_guard lock(mutex_);
  stopped_ = true;
  changed_.notify_all();
}

}  // namespace strata::server
