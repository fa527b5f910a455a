// Reservoirs of a block of 8^3 cells: the unit in which they travel to disk and merge.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/reservoir.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata {

/// The block a cell lies in.
inline Cell BlockOf(Cell cell) { return {cell.x >> 3, cell.y >> 3, cell.z >> 3}; }

/// A cell's number within its block: lexicographic by (x,y,z), 0 to 511.
inline std::uint16_t OffsetInBlock(Cell cell) {
  return static_cast<std::uint16_t>((cell.x & 7) << 6 | (cell.y & 7) << 3 | (cell.z & 7));
}
inline Cell CellOf(Cell block, std::uint16_t offset) {
  return {block.x * 8 + (offset >> 6), block.y * 8 + (offset >> 3 & 7), block.z * 8 + (offset & 7)};
}

/// Which cells of a block are occupied: bit `offset % 64` of word `offset / 64`.
using CellMask = std::array<std::uint64_t, 8>;

/// The occupied cells of a block, by offset.
struct BlockReservoirs {
  struct Entry {
    std::uint16_t offset;
    Reservoir reservoir;
  };
  Cell block;
  std::vector<Entry> cells;

  /// Merges what another part of the input left in the same block.
  void Merge(const BlockReservoirs& other);
};

/// Blocks in ascending order, each once. Threads: one.
class BlockStream {
 public:
  virtual ~BlockStream() = default;
  /// Fills `out`, or returns false at the end. Errors: of what lies below.
  virtual Result<bool> Next(BlockReservoirs& out) = 0;
};

}  // namespace strata
