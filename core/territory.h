// A part of space whose samples are decided apart from the rest.
#pragma once

#include <vector>

#include "core/block.h"
#include "core/cell_octree.h"

namespace strata {

/// Which blocks of a stream are to be decided, and which blocks it lacks. Threads: one (a cache).
class Territory {
 public:
  /// `nodes`: the cells to decide, whole blocks, ascending. `beyond`: blocks that exist and are not
  /// in the stream, ascending; those farther than `reach` blocks from each of its blocks may be
  /// left out. `reach`: samples of blocks farther apart cannot be too close to each other.
  Territory(std::vector<OctreeNode> nodes, std::vector<Cell> beyond, int reach)
      : nodes_(std::move(nodes)), beyond_(std::move(beyond)), reach_(reach) {}

  bool Owns(Cell block) const;
  bool IsBeyond(Cell block) const;
  /// Whether a block beyond lies within reach of `block`.
  bool IsNearBeyond(Cell block) const;
  const std::vector<OctreeNode>& nodes() const { return nodes_; }

 private:
  std::vector<OctreeNode> nodes_;
  std::vector<Cell> beyond_;
  int reach_;
  mutable std::size_t last_node_ = 0;
  mutable Cell last_block_;  // Of IsNearBeyond, where is_known_.
  mutable bool is_known_ = false, is_near_ = false;
};

/// The blocks within a distance of some octree nodes, in blocks along each axis.
class NearBlocks {
 public:
  NearBlocks() = default;
  /// The nodes are whole blocks, ascend and do not overlap.
  NearBlocks(std::vector<OctreeNode> nodes, int distance);
  /// Around `blocks`, in any order, some maybe twice.
  static NearBlocks Around(std::vector<Cell> blocks, int distance);

  /// Whether a block is within the distance, and `more` blocks.
  bool Has(Cell block, int more = 0) const;

 private:
  std::vector<OctreeNode> nodes_;
  int distance_ = 0;
  Cell low_{1, 1, 1}, high_;  // Blocks that the nodes lie within.
};

/// The code of a block's first cell.
inline CellCode CodeOfBlock(Cell block) { return CodeOf(CellOf(block, 0)); }

}  // namespace strata
