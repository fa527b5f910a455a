// Where workers leave reservoirs: a grid in memory, and runs on disk for what does not fit.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <vector>

#include "core/block.h"
#include "core/cell_cache.h"
#include "core/reservoir_grid.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/run_file.h"
#include "core/scratch.h"

namespace strata {

/// What a store may hold in memory.
struct StoreLimits {
  /// Without scratch space: occupied cells, give or take what workers' caches hold.
  std::uint64_t max_cells = std::numeric_limits<std::uint64_t>::max();
  /// With scratch space: bytes of the grid that fills and of the one on its way to disk together.
  std::uint64_t max_bytes = std::numeric_limits<std::uint64_t>::max();
  ScratchFolder* scratch = nullptr;     ///< Null = nothing goes to disk.
  bool barycentric = false;             ///< Whether reservoirs have their weights set.
  const RunContext* context = nullptr;  ///< Its cancel flag ends the writing of runs; may be null.
};

/// All reservoirs of a scan. A grid that reaches half of its bytes is frozen and written as a run
/// by the worker that found it so, while the others go on filling a new one.
class ReservoirStore {
 public:
  explicit ReservoirStore(const StoreLimits& limits);

  /// Merges the reservoirs of a sealed cache in. Threads: any number at once. May wait for the
  /// disk.
  void Merge(const CellCache& cache);

  /// Adds a run that another scan wrote. Threads: not while anything else runs.
  void Adopt(std::unique_ptr<ScratchFile> file, const RunExtent& extent);

  /// Whether workers should stop: over the limit of cells, or a write failed. Threads: any.
  bool full() const;
  /// Why it is full. Threads: not while Merge runs.
  Result<void> status() const;

  /// Whether all there is lies in memory. Threads: as for status.
  bool in_memory() const { return runs_.empty(); }
  const ReservoirGrid& grid() const { return *grid_; }
  std::uint64_t run_count() const { return runs_.size(); }
  std::uint64_t bytes_on_disk() const { return file_ ? file_->size() : 0; }

  /// Every block once, in order. As many runs are merged at a time as what is left of `memory`
  /// allows (at least 2), so that many are first merged into fewer. The store must outlive the
  /// stream, and nothing may be merged in any more. Errors: kIo (a damaged run of its own
  /// included), kCorruptInput (a damaged run that it adopted), kCancelled.
  Result<std::unique_ptr<BlockStream>> Blocks(const MemoryAccount& memory);

 private:
  struct Run {
    const ScratchFile* file;
    RunExtent extent;
  };

  void Spill();
  Result<void> WriteRun(BlockStream& blocks);
  Result<void> MergeRuns(std::size_t count);
  std::unique_ptr<BlockStream> Open(const Run& run) const;

  StoreLimits limits_;
  std::shared_mutex grid_mutex_;  // Exclusive: the grid is exchanged.
  std::unique_ptr<ReservoirGrid> grid_;
  std::mutex spill_mutex_;
  std::unique_ptr<ScratchFile> file_;
  std::vector<std::unique_ptr<ScratchFile>> adopted_;
  std::vector<Run> runs_;
  std::optional<Error> failure_;
  std::atomic<bool> failed_{false};
};

}  // namespace strata
