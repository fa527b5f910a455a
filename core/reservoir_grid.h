// All reservoirs of a job: a sparse OpenVDB tree from cell to slot, and side arrays of slots.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "core/block.h"
#include "core/cell_cache.h"
#include "core/reservoir.h"
#include "core/vec3.h"

namespace strata {

/// Maps cells to reservoirs. Divided into shards by block of 8^3 cells, each behind its own lock,
/// so that workers rarely meet. Memory: about 130 bytes per occupied cell.
class ReservoirGrid {
 public:
  ReservoirGrid();
  ~ReservoirGrid();
  ReservoirGrid(const ReservoirGrid&) = delete;
  ReservoirGrid& operator=(const ReservoirGrid&) = delete;

  /// Merges the reservoirs of a sealed cache in. Threads: any number at once.
  void Merge(const CellCache& cache);

  /// Number of occupied cells. Threads: any.
  std::size_t size() const { return size_.load(std::memory_order_relaxed); }
  /// What the grid holds in memory, about. Threads: any.
  std::uint64_t bytes() const { return bytes_.load(std::memory_order_relaxed); }

  /// Calls `visit(position, cell, reservoir)` for every occupied cell, in parallel, where
  /// `position` counts 0,1,2,… in the canonical order: blocks lexicographically by (x,y,z), then
  /// the cells of a block lexicographically. Threads: not while Merge runs.
  using Visitor = std::function<void(std::size_t, Cell, const Reservoir&)>;
  void VisitInOrder(const Visitor& visit) const;

  /// The blocks in ascending order, on the calling thread alone. Threads: not while Merge runs; the
  /// grid must outlive the stream.
  std::unique_ptr<BlockStream> Blocks() const;

 private:
  struct Shard;
  struct LeafPlace;
  class Stream;
  std::vector<LeafPlace> Leaves() const;
  std::unique_ptr<Shard[]> shards_;
  std::atomic<std::size_t> size_{0};
  std::atomic<std::uint64_t> bytes_{0};
};

}  // namespace strata
