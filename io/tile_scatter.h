// Sorting samples into tiles on disk.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/cell_octree.h"
#include "io/sample_rows.h"
#include "io/spool.h"

namespace strata::io {

/// Puts rows into the regions of their tiles, which lie one after the other in a spool, each of the
/// size that its tile's count says. Keeps the order of Put within a tile. Memory: 8 MiB, but at
/// least a row a tile.
class TileScatter {
 public:
  TileScatter(Spool& spool, const RowLayout& layout, std::span<const OctreeNode> tiles);

  /// Errors: kIo.
  Result<void> Put(std::size_t tile, const char* row);
  /// After the last row.
  Result<void> Finish();

 private:
  struct Region {
    std::uint64_t next = 0;  // Where its buffer goes.
    std::string buffer;
  };
  Result<void> Flush(Region& region);

  Spool& spool_;
  std::size_t row_bytes_, buffer_bytes_;
  std::vector<Region> regions_;
};

}  // namespace strata::io
