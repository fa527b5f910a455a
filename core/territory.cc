#include "core/territory.h"

#include <algorithm>
#include <cstdint>
#include <utility>

namespace strata {
namespace {

constexpr int kBlockLevel = 3;  // A block is 2^3 cells wide.

std::int32_t CellCoordinate(std::int64_t cell) {
  return static_cast<std::int32_t>(std::clamp<std::int64_t>(cell, INT32_MIN, INT32_MAX));
}

}  // namespace

bool Territory::Owns(Cell block) const {
  const CellCode code = CodeOfBlock(block);
  if (last_node_ >= nodes_.size() || !nodes_[last_node_].Holds(code)) {
    const std::size_t found = FindNode(nodes_, code);
    if (found == nodes_.size()) return false;
    last_node_ = found;
  }
  return true;
}

bool Territory::IsBeyond(Cell block) const {
  return std::binary_search(beyond_.begin(), beyond_.end(), block);
}

bool Territory::IsNearBeyond(Cell block) const {
  if (is_known_ && block == last_block_) return is_near_;
  last_block_ = block;
  is_known_ = true;
  is_near_ = false;
  for (int x = -reach_; x <= reach_ && !is_near_; ++x) {
    for (int y = -reach_; y <= reach_ && !is_near_; ++y) {
      // Those along z are neighbours in order as well.
      const Cell first{block.x + x, block.y + y, block.z - reach_};
      const auto found = std::lower_bound(beyond_.begin(), beyond_.end(), first);
      is_near_ = found != beyond_.end() && *found <= Cell{first.x, first.y, block.z + reach_};
    }
  }
  return is_near_;
}

NearBlocks::NearBlocks(std::vector<OctreeNode> nodes, int distance)
    : nodes_(std::move(nodes)), distance_(distance) {
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    const Cell low = BlockOf(CellOfCode(nodes_[n].first));
    const int wide = (1 << (nodes_[n].level - kBlockLevel)) - 1;
    const Cell high{low.x + wide, low.y + wide, low.z + wide};
    if (n == 0) low_ = low, high_ = high;
    low_ = {std::min(low_.x, low.x), std::min(low_.y, low.y), std::min(low_.z, low.z)};
    high_ = {std::max(high_.x, high.x), std::max(high_.y, high.y), std::max(high_.z, high.z)};
  }
}

NearBlocks NearBlocks::Around(std::vector<Cell> blocks, int distance) {
  std::vector<OctreeNode> nodes;
  nodes.reserve(blocks.size());
  for (const Cell block : blocks) nodes.push_back({CodeOfBlock(block), kBlockLevel, 0});
  std::sort(nodes.begin(), nodes.end(),
            [](const OctreeNode& a, const OctreeNode& b) { return a.first < b.first; });
  nodes.erase(std::unique(nodes.begin(), nodes.end(),
                          [](const auto& a, const auto& b) { return a.first == b.first; }),
              nodes.end());
  return {std::move(nodes), distance};
}

bool NearBlocks::Has(Cell block, int more) const {
  const std::int64_t d = std::int64_t{distance_} + more;
  const auto outside = [d](std::int64_t at, std::int64_t low, std::int64_t high) {
    return at + d < low || at - d > high;
  };
  if (nodes_.empty() || outside(block.x, low_.x, high_.x) || outside(block.y, low_.y, high_.y) ||
      outside(block.z, low_.z, high_.z)) {
    return false;
  }
  const auto low = [d](std::int64_t at) { return CellCoordinate((at - d) * 8); };
  const auto high = [d](std::int64_t at) { return CellCoordinate((at + d) * 8 + 7); };
  return TouchesCube(nodes_, {low(block.x), low(block.y), low(block.z)},
                     {high(block.x), high(block.y), high(block.z)});
}

}  // namespace strata
