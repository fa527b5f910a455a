// The account that a job's stages take their memory from.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>

#include "core/result.h"

namespace strata {

class MemoryAccount;

/// A part of the account, given back when it goes. Movable; empty by default.
class MemoryShare {
 public:
  MemoryShare() = default;
  MemoryShare(MemoryShare&& other) noexcept
      : account_(std::exchange(other.account_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}
  MemoryShare& operator=(MemoryShare&& other) noexcept {
    std::swap(account_, other.account_);
    std::swap(bytes_, other.bytes_);
    return *this;
  }
  ~MemoryShare();
  std::uint64_t bytes() const { return bytes_; }

 private:
  friend class MemoryAccount;
  MemoryShare(MemoryAccount* account, std::uint64_t bytes) : account_(account), bytes_(bytes) {}
  MemoryAccount* account_ = nullptr;
  std::uint64_t bytes_ = 0;
};

/// What a job may use of memory, in bytes: the bound of `--memory`. It counts what stages say they
/// take, not what they touch; a stage takes its share before it starts. Threads: any. Must outlive
/// its shares.
class MemoryAccount {
 public:
  static constexpr std::uint64_t kUnlimited = std::numeric_limits<std::uint64_t>::max();

  explicit MemoryAccount(std::uint64_t budget = kUnlimited) : budget_(budget) {}
  MemoryAccount(const MemoryAccount&) = delete;
  MemoryAccount& operator=(const MemoryAccount&) = delete;

  std::uint64_t budget() const { return budget_; }
  bool limited() const { return budget_ != kUnlimited; }
  std::uint64_t taken() const { return taken_.load(std::memory_order_relaxed); }
  std::uint64_t left() const {
    const std::uint64_t taken = this->taken();
    return taken < budget_ ? budget_ - taken : 0;
  }

  /// Takes `bytes` for `what` ("the vertices", "one tile's encoder"). Errors: kOverBudget, saying
  /// how many bytes of what budget are needed.
  Result<MemoryShare> Take(std::uint64_t bytes, const std::string& what);

 private:
  friend class MemoryShare;
  const std::uint64_t budget_;
  std::atomic<std::uint64_t> taken_{0};
};

/// Hands memory that was freed back to the system, as far as the C library can. It keeps what many
/// small objects leave, apart for each thread, and that counts as the process's own: call where a
/// stage has freed a large part of the budget. Takes milliseconds per 100 MB.
void ReturnFreedMemory();

}  // namespace strata
