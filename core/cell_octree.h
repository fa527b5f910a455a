// An octree over the lattice's cells: how they are divided into tiles, and into parcels, which are
// what machines share.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "core/vec3.h"

namespace strata {

/// A cell's coordinates, each plus 2^31, their bits interleaved with x first: the cells of one
/// octree node are one interval of codes, and so are those of each of its eight children.
__extension__ typedef unsigned __int128 CellCode;

CellCode CodeOf(Cell cell);
/// The cell of a code below 2^96.
Cell CellOfCode(CellCode code);

/// The cell of a position, from lattice and position alone; coordinates beyond int32 are cut to it.
Cell CellAt(Vec3 position, Vec3 lattice_origin, double edge);

/// An octree node: the cells with codes [first, first + 8^level).
struct OctreeNode {
  CellCode first = 0;
  int level = 0;            ///< It is 2^level cells wide.
  std::uint64_t count = 0;  ///< Of what was counted in it.

  bool Holds(CellCode code) const { return (code - first) >> (3 * level) == 0; }
};

/// The node of all cells. A plan always splits it, for no cube of cells is as wide.
inline constexpr OctreeNode kRootNode = {0, 32, 0};

/// What a node of a plan may be.
struct OctreeLimits {
  std::uint64_t most = 1;  ///< What it may hold, unless it is as small as nodes get.
  int widest_level = 31;   ///< 0 to 31.
  int finest_level = 0;    ///< Nodes of this level are not split.
};

/// Divides roots into the largest octree nodes within the limits. So the nodes are a function of
/// the roots, the limits and what is counted by cell, in whatever order.
///
/// Counts some levels below the roots first; where that is too coarse, all must be counted again:
/// Add all, Settle, and while unsettled(), Add all, Settle. Memory: about 100 bytes a counted node
/// and a node. Threads: one.
class OctreePlan {
 public:
  /// Divides the node of all cells; counts by nodes of level `start_level` first.
  OctreePlan(const OctreeLimits& limits, int start_level);
  /// Divides `roots`, which do not overlap and ascend by code.
  OctreePlan(const OctreeLimits& limits, std::span<const OctreeNode> roots);

  /// The smallest level at which `bounds` are at most 64 nodes wide.
  static int StartLevel(const Bounds& bounds, double edge);

  /// Returns false, and does not count, where the cell lies in no root.
  bool Add(CellCode code, std::uint64_t count = 1);
  void Settle();
  bool unsettled() const { return unsettled_ > 0; }

  /// Nodes that hold something, in the order of their codes: depth first, children by x, then y,
  /// then z. Precondition, as for all below: !unsettled().
  const std::vector<OctreeNode>& nodes() const { return nodes_; }
  /// The number of the node of a cell that was counted.
  std::size_t NodeOf(CellCode code) const;

 private:
  using Counts = std::map<CellCode, std::uint64_t>;  // By a node's first code.
  static constexpr int kSettled = -1;

  bool MustSplit(std::uint64_t count, int level) const {
    return level > limits_.finest_level && (count > limits_.most || level > limits_.widest_level);
  }
  void Push(const OctreeNode& node, int count_level);
  void Split(Counts::const_iterator begin, Counts::const_iterator end, int level, int count_level);

  OctreeLimits limits_;
  Counts counts_;
  CellCode last_key_ = 0;
  std::uint64_t* last_count_ = nullptr;
  std::vector<OctreeNode> nodes_;
  std::vector<int> count_level_;  // Per node: the level at which it is counted, or kSettled.
  std::size_t unsettled_ = 0;
  mutable std::size_t last_node_ = 0;
};

/// The place in `nodes`, which ascend by code and do not overlap, of the one that holds a cell;
/// their number if none does.
std::size_t FindNode(std::span<const OctreeNode> nodes, CellCode code);

/// Whether a cell of `nodes`, which ascend and do not overlap, lies in the cube of the cells
/// [low, high]. Fast where most nodes are far away.
bool TouchesCube(std::span<const OctreeNode> nodes, Cell low, Cell high);

}  // namespace strata
