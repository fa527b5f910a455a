#include "core/cell_octree.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace strata {
namespace {

constexpr double kStartNodes = 63;
// So many levels below a root are counted at once: 64 nodes, of which a surface touches some 20.
constexpr int kLevelsAtOnce = 2;

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

CellCode KeyAt(CellCode code, int level) { return code >> (3 * level) << (3 * level); }

struct Corner {
  std::int64_t x, y, z;
};

// A cube of cells, and where in the octree it is looked for.
class CubeSearch {
 public:
  CubeSearch(std::span<const OctreeNode> nodes, Cell low, Cell high)
      : nodes_(nodes), low_(low), high_(high) {}

  // Whether one of the nodes [begin, end) touches the cube; they all lie in the octree node with
  // the lowest cell `corner`.
  bool Touches(std::size_t begin, std::size_t end, OctreeNode in, Corner corner) const {
    if (begin == end || !Meets(corner, in.level)) return false;
    if (nodes_[begin].level == in.level) return true;
    const int level = in.level - 1;
    for (int child = 0; child < 8 && begin < end; ++child) {
      const CellCode from = in.first + (static_cast<CellCode>(child) << (3 * level));
      const CellCode to = from + (static_cast<CellCode>(1) << (3 * level));
      const auto all = nodes_.subspan(begin, end - begin);
      const auto after = std::partition_point(
          all.begin(), all.end(), [&](const OctreeNode& node) { return node.first < to; });
      const std::size_t stop = begin + static_cast<std::size_t>(after - all.begin());
      const Corner at = {corner.x + (static_cast<std::int64_t>(child >> 2) << level),
                         corner.y + (static_cast<std::int64_t>(child >> 1 & 1) << level),
                         corner.z + (static_cast<std::int64_t>(child & 1) << level)};
      if (Touches(begin, stop, {from, level}, at)) return true;
      begin = stop;
    }
    return false;
  }

 private:
  bool Meets(const Corner& corner, int level) const {
    const std::int64_t last = (std::int64_t{1} << level) - 1;
    const auto apart = [&](std::int64_t at, std::int64_t low, std::int64_t high) {
      return at > high || at + last < low;
    };
    return !apart(corner.x, low_.x, high_.x) && !apart(corner.y, low_.y, high_.y) &&
           !apart(corner.z, low_.z, high_.z);
  }

  std::span<const OctreeNode> nodes_;
  Cell low_, high_;
};

}  // namespace

CellCode CodeOf(Cell cell) {
  const auto raise = [](std::int32_t c) { return static_cast<std::uint32_t>(c) ^ 0x8000'0000u; };
  const std::uint64_t x = raise(cell.x), y = raise(cell.y), z = raise(cell.z);
  const CellCode high = Spread(x >> 21) << 2 | Spread(y >> 21) << 1 | Spread(z >> 21);
  const CellCode low = Spread(x) << 2 | Spread(y) << 1 | Spread(z);
  return high << 63 | low;
}

Cell CellOfCode(CellCode code) {
  std::uint32_t at[3] = {0, 0, 0};
  for (int bit = 95; bit >= 0; --bit) {
    std::uint32_t& axis = at[2 - bit % 3];
    axis = axis << 1 | static_cast<std::uint32_t>(code >> bit & 1);
  }
  const auto lower = [](std::uint32_t c) { return static_cast<std::int32_t>(c ^ 0x8000'0000u); };
  return {lower(at[0]), lower(at[1]), lower(at[2])};
}

Cell CellAt(Vec3 position, Vec3 lattice_origin, double edge) {
  const Vec3 from = position - lattice_origin;
  return {Coordinate(from.x / edge), Coordinate(from.y / edge), Coordinate(from.z / edge)};
}

OctreePlan::OctreePlan(const OctreeLimits& limits, int start_level) : limits_(limits) {
  Push(kRootNode, std::max(start_level, limits.finest_level));
}

OctreePlan::OctreePlan(const OctreeLimits& limits, std::span<const OctreeNode> roots)
    : limits_(limits) {
  for (const OctreeNode& root : roots) {
    Push(root, std::max(root.level - kLevelsAtOnce, limits.finest_level));
  }
}

int OctreePlan::StartLevel(const Bounds& bounds, double edge) {
  double cells = 0;
  for (int a = 0; a < 3; ++a) cells = std::max(cells, (bounds.max[a] - bounds.min[a]) / edge);
  int level = 0;
  while (level < kRootNode.level && std::ldexp(cells, -level) > kStartNodes) ++level;
  return level;
}

bool OctreePlan::Add(CellCode code, std::uint64_t count) {
  const std::size_t node = NodeOf(code);
  if (node == nodes_.size()) return false;
  if (count_level_[node] == kSettled) return true;
  const CellCode key = KeyAt(code, count_level_[node]);
  if (last_count_ == nullptr || key != last_key_) {
    last_key_ = key;
    last_count_ = &counts_[key];
  }
  *last_count_ += count;
  return true;
}

std::size_t OctreePlan::NodeOf(CellCode code) const {
  if (last_node_ >= nodes_.size() || !nodes_[last_node_].Holds(code)) {
    const std::size_t found = FindNode(nodes_, code);
    if (found == nodes_.size()) return found;
    last_node_ = found;
  }
  return last_node_;
}

void OctreePlan::Settle() {
  const auto before = std::exchange(nodes_, {});
  const auto levels = std::exchange(count_level_, {});
  unsettled_ = 0;
  for (std::size_t n = 0; n < before.size(); ++n) {
    const OctreeNode& node = before[n];
    if (levels[n] == kSettled) {
      Push(node, kSettled);
      continue;
    }
    const CellCode end = node.first + (static_cast<CellCode>(1) << (3 * node.level));
    Split(counts_.lower_bound(node.first), counts_.lower_bound(end), node.level, levels[n]);
  }
  counts_.clear();
  last_count_ = nullptr;
  last_node_ = 0;
}

void OctreePlan::Push(const OctreeNode& node, int count_level) {
  nodes_.push_back(node);
  count_level_.push_back(count_level);
  unsettled_ += count_level == kSettled ? 0 : 1;
}

void OctreePlan::Split(Counts::const_iterator begin, Counts::const_iterator end, int level,
                       int count_level) {
  std::uint64_t count = 0;
  for (auto at = begin; at != end; ++at) count += at->second;
  if (count == 0) return;
  const bool must_split = MustSplit(count, level);
  if (!must_split || level == count_level) {
    Push({KeyAt(begin->first, level), level, count}, must_split ? level - 1 : kSettled);
    return;
  }
  while (begin != end) {
    const CellCode child = KeyAt(begin->first, level - 1);
    auto child_end = begin;
    while (child_end != end && KeyAt(child_end->first, level - 1) == child) ++child_end;
    Split(begin, child_end, level - 1, count_level);
    begin = child_end;
  }
}

std::size_t FindNode(std::span<const OctreeNode> nodes, CellCode code) {
  const auto after =
      std::upper_bound(nodes.begin(), nodes.end(), code,
                       [](CellCode c, const OctreeNode& node) { return c < node.first; });
  const auto found = static_cast<std::size_t>(after - nodes.begin());
  return found > 0 && nodes[found - 1].Holds(code) ? found - 1 : nodes.size();
}

bool TouchesCube(std::span<const OctreeNode> nodes, Cell low, Cell high) {
  constexpr std::int64_t kLowest = -(std::int64_t{1} << 31);
  const Corner corner = {kLowest, kLowest, kLowest};
  return CubeSearch(nodes, low, high).Touches(0, nodes.size(), kRootNode, corner);
}

}  // namespace strata
