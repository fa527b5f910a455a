#include "io/tile_plan.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

namespace strata::io {
namespace {

constexpr int kRootLevel = 32;
constexpr double kStartNodes = 63;

// The low 21 bits, two zeros after each.
std::uint64_t Spread(std::uint64_t x) {
  x &= 0x1F'FFFF;
  x = (x | x << 32) & 0x001F'0000'0000'FFFF;
  x = (x | x << 16) & 0x001F'0000'FF00'00FF;
  x = (x | x << 8) & 0x100F'00F0'0F00'F00F;
  x = (x | x << 4) & 0x10C3'0C30'C30C'30C3;
  return (x | x << 2) & 0x1249'2492'4924'9249;
}

std::int32_t Coordinate(double cells) {
  const double low = -0x1p31, high = 0x1p31 - 1;
  return static_cast<std::int32_t>(std::clamp(std::floor(cells), low, high));
}

}  // namespace

CellCode CodeOf(Cell cell) {
  const auto raise = [](std::int32_t c) { return static_cast<std::uint32_t>(c) ^ 0x8000'0000u; };
  const std::uint64_t x = raise(cell.x), y = raise(cell.y), z = raise(cell.z);
  const CellCode high = Spread(x >> 21) << 2 | Spread(y >> 21) << 1 | Spread(z >> 21);
  const CellCode low = Spread(x) << 2 | Spread(y) << 1 | Spread(z);
  return high << 63 | low;
}

Cell CellAt(Vec3 position, Vec3 lattice_origin, double edge) {
  const Vec3 from = position - lattice_origin;
  return {Coordinate(from.x / edge), Coordinate(from.y / edge), Coordinate(from.z / edge)};
}

int TilePlan::StartLevel(const Bounds& bounds, double edge) {
  double cells = 0;
  for (int a = 0; a < 3; ++a) cells = std::max(cells, (bounds.max[a] - bounds.min[a]) / edge);
  int level = 0;
  while (level < kRootLevel && std::ldexp(cells, -level) > kStartNodes) ++level;
  return level;
}

void TilePlan::CountAt(CellCode code, int level) {
  const CellCode key = code >> (3 * level);
  if (last_count_ == nullptr || key != last_key_) {
    last_key_ = key;
    last_count_ = &counts_[key];
  }
  ++*last_count_;
}

void TilePlan::Recount(CellCode code) {
  if (tiles_[TileOf(code)].unsettled) CountAt(code, level_);
}

std::size_t TilePlan::TileOf(CellCode code) const {
  const auto holds = [&](const TileNode& tile) {
    return (code - tile.first) >> (3 * tile.level) == 0;
  };
  if (last_tile_ >= tiles_.size() || !holds(tiles_[last_tile_])) {
    const auto after =
        std::upper_bound(tiles_.begin(), tiles_.end(), code,
                         [](CellCode c, const TileNode& tile) { return c < tile.first; });
    last_tile_ = static_cast<std::size_t>(std::distance(tiles_.begin(), after)) - 1;
  }
  return last_tile_;
}

void TilePlan::Settle() {
  if (tiles_.empty()) {
    if (!counts_.empty()) Split(counts_.begin(), counts_.end(), kRootLevel);
  } else {
    Refine();
  }
  counts_.clear();
  last_count_ = nullptr;
  last_tile_ = 0;
  if (unsettled_ > 0) --level_;
}

void TilePlan::Push(CellCode first, int level, std::uint64_t count) {
  const bool unsettled = MustSplit(count, level);
  tiles_.push_back({first, level, count, unsettled});
  unsettled_ += unsettled ? 1 : 0;
}

void TilePlan::Split(Counts::const_iterator begin, Counts::const_iterator end, int level) {
  std::uint64_t count = 0;
  for (auto at = begin; at != end; ++at) count += at->second;
  if (level == level_ || !MustSplit(count, level)) {
    const int above = 3 * (level - level_);
    Push(begin->first >> above << above << (3 * level_), level, count);
    return;
  }
  const int to_child = 3 * (level - 1 - level_);
  while (begin != end) {
    const CellCode child = begin->first >> to_child;
    auto child_end = begin;
    while (child_end != end && child_end->first >> to_child == child) ++child_end;
    Split(begin, child_end, level - 1);
    begin = child_end;
  }
}

// The counts are those of the unsettled tiles' children now.
void TilePlan::Refine() {
  std::vector<TileNode> before = std::move(tiles_);
  tiles_.clear();
  unsettled_ = 0;
  auto child = counts_.begin();
  for (const TileNode& tile : before) {
    if (!tile.unsettled) {
      tiles_.push_back(tile);
      continue;
    }
    const CellCode end = (tile.first >> (3 * level_)) + 8;
    for (; child != counts_.end() && child->first < end; ++child) {
      Push(child->first << (3 * level_), level_, child->second);
    }
  }
}

}  // namespace strata::io
