// The arrivals of a stretch of time, as many as fit.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <span>
#include <vector>

#include "core/result.h"
#include "core/uniform_arrivals.h"

namespace strata {

/// Collects arrivals before a time. When they outgrow the capacity, the time is brought forward:
/// what is kept are always all arrivals before `end()`. Each point of the surface once, whatever
/// the number of its triangle's coincident copies.
class UniformBand {
 public:
  /// Memory: capacity arrivals, as used. Precondition: capacity >= kLeastCapacity.
  static constexpr std::size_t kLeastCapacity = 4096, kMostAtOnce = 512;
  explicit UniformBand(std::size_t capacity);

  /// Empties it for the arrivals in [begin, end). Threads: one, and nothing else runs.
  void Reset(double begin, double end);
  double begin() const { return begin_; }
  /// Grows smaller while arrivals are added. Threads: any.
  double end() const { return end_.load(std::memory_order_relaxed); }

  /// Adds up to kMostAtOnce arrivals, of which those before end() count. Threads: any. Errors:
  /// kInternal, if all that fits arrived at one and the same time.
  Result<void> Add(std::span<const UniformArrival> some);

  /// Once all are added: those before end(), in order. Threads: one, and nothing else runs.
  std::span<const UniformArrival> Settle();

 private:
  void SortOut();
  Result<void> Shorten();

  std::size_t capacity_;
  double begin_ = 0;
  std::atomic<double> end_{0};
  std::mutex mutex_;
  std::vector<UniformArrival> arrivals_;
};

}  // namespace strata
