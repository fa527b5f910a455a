// Where workers leave reservoirs: a grid in memory, and runs on disk for what does not fit.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <shared_mutex>
#include <span>
#include <thread>
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
  ScratchFolder* scratch = nullptr;        ///< Null = nothing goes to disk.
  bool barycentric = false;                ///< Whether reservoirs have their weights set.
  CheckpointPlace* checkpoints = nullptr;  ///< Where runs outlive the process; null = nowhere.
  const RunContext* context = nullptr;  ///< Its cancel flag ends the writing of runs; may be null.
};

/// A run of a store, or what is wanted of it.
struct StoredRun {
  std::shared_ptr<const ScratchFile> file;
  RunExtent extent;
  /// The frames to read (core/run_index.h); null = all.
  std::shared_ptr<const std::vector<std::uint64_t>> frames = nullptr;
  std::function<bool(Cell block)> wanted = nullptr;  ///< Of their blocks; null = all.
};

/// All reservoirs of a scan. A grid that reaches half of its bytes is frozen and written as a run
/// by the worker that found it so, while the others go on filling a new one.
class ReservoirStore {
 public:
  explicit ReservoirStore(const StoreLimits& limits);
  ~ReservoirStore();
  ReservoirStore(const ReservoirStore&) = delete;
  ReservoirStore& operator=(const ReservoirStore&) = delete;

  /// Merges the reservoirs of a sealed cache in. Threads: any number at once. May wait for the
  /// disk.
  void Merge(const CellCache& cache);

  /// Adds a run that another scan wrote. Threads: not while anything else runs.
  void Adopt(StoredRun run);

  /// Goes on with runs that a former process left. Threads: as for Adopt. Errors: kIo.
  Result<void> Restore(const std::vector<RunExtent>& runs);

  /// Whether the grid will soon have to go to disk, or had to: a good time for a checkpoint.
  /// Threads: any.
  bool wants_checkpoint();
  /// Takes what was merged in so far for the contents of a checkpoint: returns at once, writes it
  /// as a run beside whatever comes next, and then calls `save` with all runs that hold it, from
  /// another thread. Later, when runs become others that hold the same, `save` is called again
  /// before the old ones go. What fails shows in status(). Threads: not while Merge runs.
  using SaveRuns = std::function<Result<void>(std::span<const RunExtent>)>;
  void Checkpoint(SaveRuns save);

  /// Whether workers should stop: over the limit of cells, or a write failed. Threads: any.
  bool full() const;
  /// Why it is full, once all writing has ended. Threads: not while Merge runs.
  Result<void> status();

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
  void Spill();
  void Settle();
  void Note(const Result<void>& written);
  Result<void> WriteCheckpoint(const ReservoirGrid& frozen, std::vector<StoredRun> held);
  Result<void> SaveCheckpoint(std::span<const StoredRun> runs) const;
  Result<void> OpenFile(std::uint64_t keep);
  Result<StoredRun> WriteRun(BlockStream& blocks);
  Result<void> MergeRuns(std::size_t count);
  std::unique_ptr<BlockStream> Open(const StoredRun& run) const;

  StoreLimits limits_;
  std::shared_mutex grid_mutex_;  // Exclusive: the grid is exchanged.
  bool spilled_ = false;          // By a worker, since the last checkpoint. Of grid_mutex_.
  std::unique_ptr<ReservoirGrid> grid_;
  std::mutex spill_mutex_;  // Guards the file, the runs and the failure while workers run.
  std::thread writer_;      // Of the last checkpoint.
  SaveRuns save_;           // Of the last checkpoint.
  std::shared_ptr<ScratchFile> file_;
  std::vector<StoredRun> runs_;
  std::optional<Error> failure_;
  std::atomic<bool> failed_{false};
};

}  // namespace strata
