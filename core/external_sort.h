// Sorting more records than memory holds.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"

namespace strata {

/// Takes records of one size, each beginning with its key (a uint64), and hands them out by
/// ascending key; records of equal keys in the order in which they came.
///
/// Add any number of records, then Sort once, then Next until it gives null. Memory: `memory_bytes`
/// or a little less, taken from the context's account while the sorter lives; the rest goes to
/// scratch space, where every record is written and read once. Threads: one at a time.
class ExternalSort {
 public:
  /// What it can do with at least.
  static constexpr std::uint64_t kLeastBytes = std::uint64_t{1} << 20;

  /// For `what`, in messages. record_bytes is a multiple of 8, at least 8; memory_bytes at least
  /// kLeastBytes. Without scratch space what does not fit is kOverBudget.
  static Result<std::unique_ptr<ExternalSort>> Open(std::size_t record_bytes,
                                                    std::uint64_t memory_bytes, const char* what,
                                                    RunContext& context);

  /// Errors: kOverBudget, kIo, kCancelled.
  Result<void> Add(const char* record);
  /// Errors: the same.
  Result<void> Sort();
  /// The next record, or null at the end; valid until the next call. Errors: kIo.
  Result<const char*> Next();
  std::uint64_t size() const { return size_; }

 private:
  // A sorted part on scratch, and what of it is at hand.
  struct Run {
    std::uint64_t next = 0, end = 0;  // In the file, bytes.
    std::vector<char> buffer;
    std::size_t at = 0, filled = 0;
  };

  ExternalSort(std::size_t record_bytes, std::uint64_t memory_bytes, const char* what,
               RunContext& context);
  std::uint64_t KeyAt(const char* record) const;
  void SortInMemory();
  const char* InMemory(std::size_t rank) const;
  Result<void> Spill();
  Result<bool> Refill(Run& run);
  bool IsAfter(std::uint32_t a, std::uint32_t b) const;

  const std::size_t record_bytes_, most_records_;
  const char* const what_;
  RunContext& context_;
  MemoryShare share_;
  std::vector<char> records_;
  struct Place {
    std::uint64_t key;
    std::uint32_t index;
  };
  std::vector<Place> order_;
  std::unique_ptr<ScratchFile> file_;
  std::vector<Run> runs_;
  std::vector<std::uint32_t> heap_;  // Runs by their next key.
  std::uint64_t size_ = 0;
  std::size_t rank_ = 0;  // Of the next record where all are in memory.
  bool started_ = false;
};

}  // namespace strata
