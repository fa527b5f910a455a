// The scan: every triangle of a mesh raced into the grid, on all threads.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "core/cell_race.h"
#include "core/mesh_reader.h"
#include "core/reservoir_store.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/sample_mesh.h"
#include "core/scan_kernel.h"

namespace strata {

/// A worker takes up to this many batches at a time once a mesh has shown to be large: neighbours
/// in the file mostly share cells, which are then raced for by one worker instead of by several.
inline constexpr std::size_t kMostBatches = 16;

/// What a worker and the batches under way for it hold in memory, about, in bytes.
std::uint64_t WorkerBytes(std::size_t batch_size, std::size_t most_batches);

/// How to scan, beyond the kernel's parameters.
struct ScanOptions {
  ScanParameters kernel;
  Integrator integrator = Integrator::kExact;
  bool barycentric = false;
  bool strict = false;
  int threads = 1;
  std::size_t batch_size = 2048;
  std::size_t most_batches = kMostBatches;
  Share share;  ///< Other shares' triangles are passed over; read and dropped where that must be.
};

/// What a scan found, beside the reservoirs.
struct ScanTotals {
  BatchTotals batch;     ///< Sums over all batches, in file order.
  SkipCounts skipped{};  ///< kNonFinite and kZeroArea.
  /// The share's part of what the reader counted: over all shares these add up to the whole mesh's.
  /// Where a reader cannot pass over other shares' triangles, share 0 has it all.
  ReadCounts read;
  std::uint64_t pieces = 0;
  /// Usable triangles that left no piece, being thinner than the rounding of their corners; they
  /// count as kZeroArea.
  std::uint64_t thin = 0;
};

/// How far a scan has come.
struct ScanState {
  std::uint64_t next = 0;  ///< Triangles before this number in file order are in the runs.
  bool complete = false;   ///< All are.
  ScanTotals totals;       ///< Of these.
};

/// How a scan can be gone on with, should the process die.
struct ScanCheckpoints {
  /// Called now and then, when all before `state.next` is in `runs`, from one thread at a time; a
  /// failure ends the scan. Empty: no checkpoints.
  std::function<Result<void>(const ScanState& state, std::span<const RunExtent> runs)> save;
  /// Where a former scan got to, whose runs the store has been given.
  ScanState from;
};

/// Reads `reader`, of which nothing was read since opening or Rewind, to its end and races every
/// triangle of the share into `store`; leaves the share selected. Call inside the arena that is to
/// be used. Memory: a few batches and one cache per thread. Errors: the reader's, kCancelled,
/// kOverBudget (cell coordinates beyond kMaxCellCoordinate), kCorruptInput (strict).
Result<ScanTotals> ScanTriangles(MeshReader& reader, const ScanOptions& options,
                                 ReservoirStore& store, RunContext& context,
                                 const ScanCheckpoints& checkpoints = {});

}  // namespace strata
