// Bytes that wait for their place in an output: on scratch disk, or in memory where there is none.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "core/scratch.h"

namespace strata::io {

/// A file of scratch space, or memory that behaves like one. Threads: one at a time. Memory: a
/// buffer of kBufferBytes on scratch; what it holds otherwise.
class Spool {
 public:
  static constexpr std::size_t kBufferBytes = std::size_t{1} << 18;

  /// `bytes` is what will be written altogether; without `scratch` they are taken from `memory`,
  /// for `what`, at once. Either pointer may be null: no scratch, no bound.
  /// Errors: kOverBudget, kIo.
  static Result<std::unique_ptr<Spool>> Open(ScratchFolder* scratch, MemoryAccount* memory,
                                             std::uint64_t bytes, const std::string& what);

  /// Errors: kIo; kOverBudget when memory runs out.
  Result<void> Append(std::string_view bytes);
  /// At any place below the size that Open was told. After it, no Append.
  Result<void> WriteAt(std::uint64_t offset, std::string_view bytes);
  /// Fills `out` from byte `offset`. Errors: kIo.
  Result<void> Read(std::uint64_t offset, std::span<char> out);
  /// The bytes before `end` are not needed any more.
  void DiscardBefore(std::uint64_t end);
  std::uint64_t size() const { return size_; }

 private:
  static constexpr std::size_t kChunkBytes = std::size_t{1} << 18;

  Spool() = default;
  Result<void> Flush();
  Result<void> Store(std::uint64_t offset, std::string_view bytes);

  std::unique_ptr<ScratchFile> file_;            // Null: memory.
  std::vector<std::unique_ptr<char[]>> chunks_;  // Of kChunkBytes; null before and after use.
  MemoryShare share_;
  std::string buffer_;  // Not yet in file_.
  std::uint64_t size_ = 0, discarded_ = 0;
};

}  // namespace strata::io
