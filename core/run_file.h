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

namespace strata {

/// Where a run lies in a file, and what it holds.
struct RunExtent {
  std::uint64_t offset = 0, bytes = 0;
  std::uint64_t blocks = 0, cells = 0;
};

/// What a run's writer or reader holds in memory, about, in bytes.
inline constexpr std::uint64_t kRunBufferBytes = 640 << 10;

class FrameReader;

/// Collects what the index of a run says of its blocks. Memory: up to 384 blocks.
class IndexBuilder {
 public:
  void Add(const BlockReservoirs& block);
  /// After the blocks of a frame of `bytes`.
  void EndFrame(std::uint64_t bytes);
  /// Whether there is enough for an index frame.
  bool full() const;
  bool empty() const { return blocks_.empty(); }
  /// The content of an index frame about what was added since the last one.
  void Pack(std::string& out);
  /// By how many blocks samples lie outside the block of their cell, at most.
  std::uint64_t spread() const { return spread_; }

 private:
  std::vector<Cell> blocks_;
  std::vector<CellMask> masks_;
  std::vector<std::uint32_t> frame_bytes_, frame_blocks_;
  std::size_t framed_ = 0;  // Blocks in frames.
  std::uint64_t spread_ = 0;
};

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
  Result<void> WriteIndex();
  Result<void> WriteDirectory();
  Result<void> WriteCompressed(std::string_view raw);
  Result<void> Put(std::string_view bytes);

  struct FreeContext {
    void operator()(ZSTD_CCtx_s* context) const;
  };
  AppendBytes append_;
  bool barycentric_;
  RunExtent extent_;
  std::vector<Cell> blocks_;  // Of the frame that is being filled.
  std::vector<std::uint16_t> counts_;
  std::vector<BlockReservoirs::Entry> cells_;
  IndexBuilder index_;
  std::vector<std::uint64_t> directory_;  // Where index frames start, from the run's first byte.
  std::string raw_, compressed_;
  std::unique_ptr<ZSTD_CCtx_s, FreeContext> context_;
};

/// Reads one run back, or some frames of it. Every frame's checksum is verified, and at the end of
/// the whole the counts. Errors: kIo; `damage` for a damaged or incomplete run, with file and
/// offset.
class RunReader : public BlockStream {
 public:
  /// `damage`: kCorruptInput where the run is an input; kIo where this process wrote it, and it is
  /// the disk that is at fault.
  RunReader(const ScratchFile& file, const RunExtent& extent,
            ErrorCode damage = ErrorCode::kCorruptInput);
  /// Of the run, only the frames of reservoirs that start at these bytes of the file, ascending
  /// (core/run_index.h).
  RunReader(const ScratchFile& file, const RunExtent& extent,
            std::shared_ptr<const std::vector<std::uint64_t>> frames, ErrorCode damage);
  ~RunReader() override;
  Result<bool> Next(BlockReservoirs& out) override;

 private:
  Result<bool> ReadFrame();
  Result<bool> ReadChosenFrame();
  Result<void> Unpack();
  Result<void> CheckIndex();
  Result<bool> ReadEnd();

  std::unique_ptr<FrameReader> frame_;
  std::shared_ptr<const std::vector<std::uint64_t>> chosen_;  // Null = all.
  std::size_t next_chosen_ = 0;
  std::uint64_t blocks_read_ = 0, cells_read_ = 0, indexed_ = 0;
  std::vector<Cell> blocks_;
  std::vector<std::uint16_t> counts_;
  std::vector<BlockReservoirs::Entry> cells_;
  std::size_t next_block_ = 0, next_cell_ = 0;
  bool at_end_ = false;
};

}  // namespace strata
