#include "core/uniform_band.h"

#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

#include <algorithm>

namespace strata {

UniformBand::UniformBand(std::size_t capacity) : capacity_(capacity) {
  arrivals_.reserve(capacity);
}

void UniformBand::Reset(double begin, double end) {
  begin_ = begin;
  end_.store(end, std::memory_order_relaxed);
  arrivals_.clear();
}

Result<void> UniformBand::Add(std::span<const UniformArrival> some) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (capacity_ - arrivals_.size() < some.size()) {
    if (auto shortened = Shorten(); !shortened) return shortened;
  }
  for (const UniformArrival& arrival : some) {
    if (arrival.time < end()) arrivals_.push_back(arrival);
  }
  return {};
}

std::span<const UniformArrival> UniformBand::Settle() {
  SortOut();
  return arrivals_;
}

void UniformBand::SortOut() {
  // Isolated: a thread that waits here with the lock must not take up work that wants it.
  tbb::this_task_arena::isolate([&] { tbb::parallel_sort(arrivals_.begin(), arrivals_.end()); });
  const auto copies =
      std::unique(arrivals_.begin(), arrivals_.end(),
                  [](const UniformArrival& a, const UniformArrival& b) { return b.IsCopyOf(a); });
  arrivals_.erase(copies, arrivals_.end());
}

// Makes room: first by dropping copies, then by bringing the end forward.
Result<void> UniformBand::Shorten() {
  SortOut();
  if (arrivals_.size() <= capacity_ / 4 * 3) return {};
  const double end = arrivals_[capacity_ / 2].time;
  while (!arrivals_.empty() && arrivals_.back().time >= end) arrivals_.pop_back();
  end_.store(end, std::memory_order_relaxed);
  if (!arrivals_.empty()) return {};
  return Fail(ErrorCode::kInternal, "more points arrived at one time than fit memory");
}

}  // namespace strata
