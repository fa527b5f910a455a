#include "io/tile_scatter.h"

#include <algorithm>

namespace strata::io {
namespace {

constexpr std::size_t kAllBuffers = std::size_t{8} << 20, kLargestBuffer = std::size_t{1} << 18;

}  // namespace

TileScatter::TileScatter(Spool& spool, const RowLayout& layout, std::span<const OctreeNode> tiles)
    : spool_(spool), row_bytes_(layout.bytes()), regions_(tiles.size()) {
  const std::size_t each =
      std::min(kAllBuffers / std::max<std::size_t>(tiles.size(), 1), kLargestBuffer);
  buffer_bytes_ = std::max(each / row_bytes_, std::size_t{1}) * row_bytes_;
  std::uint64_t at = 0;
  for (std::size_t k = 0; k < tiles.size(); ++k) {
    regions_[k].next = at;
    at += tiles[k].count * row_bytes_;
  }
}

Result<void> TileScatter::Put(std::size_t tile, const char* row) {
  Region& region = regions_[tile];
  region.buffer.append(row, row_bytes_);
  return region.buffer.size() < buffer_bytes_ ? Result<void>() : Flush(region);
}

Result<void> TileScatter::Flush(Region& region) {
  auto written = spool_.WriteAt(region.next, region.buffer);
  region.next += region.buffer.size();
  region.buffer.clear();
  return written;
}

Result<void> TileScatter::Finish() {
  for (Region& region : regions_) {
    if (auto written = Flush(region); !written) return written;
  }
  return {};
}

}  // namespace strata::io
