// Runs: reservoirs on disk, sorted by block, compressed and checked. docs/run-format.md has the
// layout.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/block.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"

struct ZSTD_CCtx_s;
struct ZSTD_DCtx_s;

namespace strata {

/// Where a run lies in a file, and what it holds.
struct RunExtent {
  std::uint64_t offset = 0, bytes = 0;
  std::uint64_t blocks = 0, cells = 0;
};

/// What a run's writer or reader holds in memory, about, in bytes.
inline constexpr std::uint64_t kRunBufferBytes = 640 << 10;

/// Takes bytes at the end of a file. Errors: kIo.
using AppendBytes = std::function<Result<void>(std::string_view)>;

/// Appends one run to a file. Threads: one. Destroyed before Finish it leaves a run that no reader
/// takes for whole.
class RunWriter {
 public:
  /// `begin`: where in the file the run starts; `barycentric`: whether reservoirs have their
  /// weights set.
  RunWriter(AppendBytes append, std::uint64_t begin, bool barycentric);
  ~RunWriter();
  /// Blocks must come in ascending order, none empty. Errors: kIo.
  Result<void> Add(const BlockReservoirs& block);
  Result<RunExtent> Finish();
  /// Adds what is left of a stream, and finishes. `context`: whose cancel flag is looked at before
  /// each block; may be null. Errors: the stream's, kIo, kCancelled.
  Result<RunExtent> WriteAll(BlockStream& blocks, const RunContext* context);

 private:
  Result<void> WriteFrame();
  Result<void> WriteCompressed(std::string_view raw);

  struct FreeContext {
    void operator()(ZSTD_CCtx_s* context) const;
  };
  AppendBytes append_;
  bool barycentric_;
  RunExtent extent_;
  std::vector<Cell> blocks_;  // Of the frame that is being filled.
  std::vector<std::uint16_t> counts_;
  std::vector<BlockReservoirs::Entry> cells_;
  std::string raw_, compressed_;
  std::unique_ptr<ZSTD_CCtx_s, FreeContext> context_;
};

/// Reads one run back. Every frame's checksum is verified, and at the end the counts. Errors: kIo;
/// `damage` for a damaged or incomplete run, with file and offset.
class RunReader : public BlockStream {
 public:
  /// `damage`: kCorruptInput where the run is an input; kIo where this process wrote it, and it is
  /// the disk that is at fault.
  RunReader(const ScratchFile& file, const RunExtent& extent,
            ErrorCode damage = ErrorCode::kCorruptInput);
  ~RunReader() override;
  Result<bool> Next(BlockReservoirs& out) override;

 private:
  Result<bool> ReadFrame();
  Result<void> Unpack();
  Result<bool> ReadEnd(std::uint32_t raw_bytes);
  tl::unexpected<Error> Damaged(const std::string& what) const;

  struct FreeContext {
    void operator()(ZSTD_DCtx_s* context) const;
  };
  const ScratchFile& file_;
  ErrorCode damage_;
  std::uint64_t begin_, at_, end_;
  std::uint64_t blocks_read_ = 0, cells_read_ = 0;
  std::string compressed_, raw_;
  std::vector<Cell> blocks_;
  std::vector<std::uint16_t> counts_;
  std::vector<BlockReservoirs::Entry> cells_;
  std::size_t next_block_ = 0, next_cell_ = 0;
  std::unique_ptr<ZSTD_DCtx_s, FreeContext> context_;
};

}  // namespace strata
