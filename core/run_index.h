// The index of a run: which blocks it holds, which cells of them, and where, without the
// reservoirs.
#pragma once

#include <bit>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/block.h"
#include "core/result.h"
#include "core/run_file.h"
#include "core/scratch.h"

struct ZSTD_DCtx_s;

namespace strata {

class FrameReader;

/// What an index says of a block.
struct IndexedBlock {
  Cell block;
  CellMask cells{};
  std::uint64_t frame = 0;  ///< The byte of the file at which the frame with its reservoirs starts.
};

/// What a reader of an index holds in memory at most, in bytes, beside 8 bytes for every 128
/// blocks.
inline constexpr std::uint64_t kIndexBufferBytes = 100 << 10;

/// Reads the index of one run from front to back, any number of times. Threads: one.
class RunIndex {
 public:
  /// Reads where the parts of the index lie. `unpack`, of NewUnpackContext (core/run_frame.h), may
  /// be shared with other readers of the thread. The file must outlive this. Errors: kIo;
  /// kCorruptInput for a damaged run, with file and offset.
  static Result<std::unique_ptr<RunIndex>> Open(const ScratchFile& file, const RunExtent& extent,
                                                std::shared_ptr<ZSTD_DCtx_s> unpack);
  ~RunIndex();
  RunIndex(const RunIndex&) = delete;
  RunIndex& operator=(const RunIndex&) = delete;

  /// Blocks ascend, each once; false at the end. Errors: as Open.
  Result<bool> Next(IndexedBlock& out);
  void Rewind();

  /// By how many blocks samples lie outside the block of their cell, at most.
  std::uint64_t spread() const { return spread_; }
  const RunExtent& extent() const { return extent_; }

 private:
  RunIndex(std::unique_ptr<FrameReader> frame, const RunExtent& extent);
  Result<void> ReadEnd();
  Result<void> ReadDirectory(std::uint64_t begin, std::uint64_t end);
  Result<void> ReadPart();
  Result<void> PlaceFrames(std::uint64_t part, const std::vector<std::uint32_t>& bytes,
                           const std::vector<std::uint32_t>& blocks);

  std::unique_ptr<FrameReader> frame_;
  RunExtent extent_;
  std::uint64_t spread_ = 0;
  std::vector<std::uint64_t> parts_;  // Where index frames start in the file, ascending.
  std::size_t next_part_ = 0;
  std::vector<IndexedBlock> blocks_;  // Of one part.
  std::size_t next_block_ = 0;
  std::uint64_t blocks_read_ = 0, cells_read_ = 0;
};

/// The occupied cells of several runs together. Memory: as the indexes'.
class MergedIndex {
 public:
  /// The indexes must outlive this; they are rewound.
  explicit MergedIndex(const std::vector<std::unique_ptr<RunIndex>>& indexes);
  /// As RunIndex::Next, but for the frame.
  Result<bool> Next(IndexedBlock& out);

 private:
  Result<void> Advance(std::size_t run);

  const std::vector<std::unique_ptr<RunIndex>>& indexes_;
  std::vector<IndexedBlock> front_;  // Per run.
  std::vector<std::size_t> heap_;    // Runs by their front block, the lowest first.
  bool started_ = false;
};

/// How many cells a mask says.
inline std::uint32_t CellsIn(const CellMask& mask) {
  std::uint32_t cells = 0;
  for (const std::uint64_t word : mask) cells += static_cast<std::uint32_t>(std::popcount(word));
  return cells;
}

}  // namespace strata
