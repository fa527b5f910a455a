// How much disk a kind of file may take.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <utility>

#include "core/result.h"

namespace strata::server {

class DiskBudget;

/// Bytes taken from a budget, given back with their owner. Threads: one at a time.
class DiskShare {
 public:
  DiskShare() = default;
  DiskShare(DiskShare&& other) noexcept
      : budget_(std::exchange(other.budget_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}
  DiskShare& operator=(DiskShare&& other) noexcept;
  ~DiskShare();

  std::uint64_t bytes() const { return bytes_; }
  /// Takes `bytes` more; false, and nothing taken, when the budget does not have them.
  bool Grow(std::uint64_t bytes);
  /// Gives the share back, and counts `bytes` as being on the disk from now on.
  void Keep(std::uint64_t bytes);

 private:
  friend class DiskBudget;
  explicit DiskShare(DiskBudget* budget) : budget_(budget) {}
  DiskBudget* budget_ = nullptr;
  std::uint64_t bytes_ = 0;
};

/// Counts bytes against a limit. Outlives its shares. Threads: any.
class DiskBudget {
 public:
  /// `what` is for messages: "models".
  DiskBudget(std::string what, std::uint64_t limit_bytes)
      : what_(std::move(what)), limit_(limit_bytes) {}

  /// An empty share, to be grown.
  DiskShare NewShare() { return DiskShare(this); }
  /// A share of what is on the disk already, over the limit too.
  DiskShare TakeAnyway(std::uint64_t bytes);
  /// Counts what is on the disk already, over the limit too.
  void Add(std::uint64_t bytes);
  /// Replaces the count of what is on the disk: other processes have changed it too.
  void SetOnDisk(std::uint64_t bytes);
  /// Gives back what was kept or added.
  void Remove(std::uint64_t bytes);

  std::uint64_t used() const;
  std::uint64_t limit() const { return limit_; }
  /// kOverBudget: how much was wanted, how much is left.
  tl::unexpected<Error> FailOver(std::uint64_t wanted) const;

 private:
  friend class DiskShare;
  bool Take(std::uint64_t bytes);
  void Return(std::uint64_t bytes);
  void Settle(std::uint64_t share, std::uint64_t kept);

  std::string what_;
  std::uint64_t limit_;
  mutable std::mutex mutex_;
  std::uint64_t shares_ = 0, on_disk_ = 0;
};

}  // namespace strata::server
