// Which samples share a tile: an octree over the lattice's cells.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "core/vec3.h"

namespace strata::io {

/// A cell's coordinates, each plus 2^31, their bits interleaved with x first: the cells of one
/// octree node are one interval of codes, and so are those of each of its eight children.
__extension__ typedef unsigned __int128 CellCode;

CellCode CodeOf(Cell cell);

/// The cell of a position, from lattice and position alone; coordinates beyond int32 are cut to it.
Cell CellAt(Vec3 position, Vec3 lattice_origin, double edge);

/// An octree node: the cells with codes [first, first + 8^level).
struct TileNode {
  CellCode first = 0;
  int level = 0;            ///< It is 2^level cells wide.
  std::uint64_t count = 0;  ///< Samples in it, > 0.
  bool unsettled = false;   ///< It must be split, and how its samples lie in it is not known yet.
};

/// Finds the tiles: the largest octree nodes that hold at most `tile_samples` samples and are at
/// most 2^widest_level cells wide. A single cell is not split, whatever it holds. So they are a
/// function of the samples' cells and the two limits.
///
/// Counts samples by nodes of 2^start_level cells first; where that is too coarse, the samples must
/// be counted again, one level finer each time: Add all, Settle, and while unsettled(), Recount
/// all, Settle. Memory: about 100 bytes a counted node and a tile.
class TilePlan {
 public:
  TilePlan(std::uint64_t tile_samples, int widest_level, int start_level)
      : tile_samples_(tile_samples), widest_level_(widest_level), level_(start_level) {}

  /// The smallest level at which `bounds` are at most 64 nodes wide.
  static int StartLevel(const Bounds& bounds, double edge);

  void Add(CellCode code) { CountAt(code, level_); }
  void Recount(CellCode code);
  void Settle();
  bool unsettled() const { return unsettled_ > 0; }

  /// In the order of their codes: depth first, children by x, then y, then z.
  const std::vector<TileNode>& tiles() const { return tiles_; }
  /// The tile of a cell that was counted. Precondition: !unsettled().
  std::size_t TileOf(CellCode code) const;

 private:
  using Counts = std::map<CellCode, std::uint64_t>;  // By code >> 3 * level_.

  bool MustSplit(std::uint64_t count, int level) const {
    return level > 0 && (count > tile_samples_ || level > widest_level_);
  }
  void CountAt(CellCode code, int level);
  void Push(CellCode first, int level, std::uint64_t count);
  void Split(Counts::const_iterator begin, Counts::const_iterator end, int level);
  void Refine();

  std::uint64_t tile_samples_;
  int widest_level_;
  int level_;  // Of the counts.
  Counts counts_;
  CellCode last_key_ = 0;
  std::uint64_t* last_count_ = nullptr;
  std::vector<TileNode> tiles_;
  std::size_t unsettled_ = 0;
  mutable std::size_t last_tile_ = 0;
};

}  // namespace strata::io
