// Rows of one size by number: what a mesh's vertices carry, while samples fetch it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"
#include "io/byte_source.h"

namespace strata::io {

/// Rows in memory, on scratch disk, or where they stand in the mesh's own file. Threads: one at a
/// time.
class RowTable {
 public:
  /// Empty, to be filled by Append. Rows beyond a quarter of what is left of the context's account
  /// go to its scratch space. `context` must outlive the table.
  RowTable(std::size_t row_bytes, RunContext& context);
  /// `count` rows from byte `offset` of `source` on, which must be there and outlive the table.
  /// Precondition: source.can_read_at().
  RowTable(std::size_t row_bytes, ByteSource& source, std::uint64_t offset, std::uint64_t count);

  std::size_t row_bytes() const { return row_bytes_; }
  std::uint64_t size() const { return size_; }

  /// Adds a row. Errors: kOverBudget (no scratch space), kIo. Throws std::bad_alloc.
  Result<void> Append(const char* row);
  /// After the last Append. Errors: the same.
  Result<void> Finish();
  /// Reads rows that lie in a file into memory if they are few enough for that to be cheap, and
  /// take no more than an eighth of what is left of the context's account. Errors: kIo.
  Result<void> LoadIfSmall(RunContext& context);
  /// Whether all rows are in memory.
  bool resident() const { return source_ == nullptr && file_ == nullptr; }
  /// A row. Preconditions: resident(), number < size(). Valid as long as the table.
  const char* Row(std::uint64_t number) const {
    return rows_[number / per_part_].data() + number % per_part_ * row_bytes_;
  }
  /// Copies the rows with these numbers, ascending and below size(), to `out`. Reads the file
  /// forwards, and little of it beyond the rows. Errors: kIo.
  Result<void> Gather(std::span<const std::uint64_t> numbers, char* out) const;

 private:
  Result<void> Spill();
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) const;

  const std::size_t row_bytes_, per_part_;
  RunContext* context_ = nullptr;
  ByteSource* source_ = nullptr;  // Or null: then file_, or rows_ where that is null too.
  std::unique_ptr<ScratchFile> file_;
  std::uint64_t offset_ = 0, size_ = 0, most_bytes_ = 0;
  std::vector<std::vector<char>> rows_;  // In parts of kPartBytes, so that none moves as it grows.
  MemoryShare share_;
};

}  // namespace strata::io
