// The plan against an octree built the plain way: top down, with every cell at hand.
#include "core/cell_octree.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>
#include <string>

namespace strata {
namespace {

// Bit by bit.
CellCode SlowCode(Cell cell) {
  CellCode code = 0;
  const std::uint32_t raised[] = {static_cast<std::uint32_t>(cell.x) + 0x8000'0000u,
                                  static_cast<std::uint32_t>(cell.y) + 0x8000'0000u,
                                  static_cast<std::uint32_t>(cell.z) + 0x8000'0000u};
  for (int bit = 31; bit >= 0; --bit) {
    for (const std::uint32_t c : raised) code = code << 1 | (c >> bit & 1);
  }
  return code;
}

std::vector<Cell> RandomCells(std::size_t n, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<Cell> cells;
  for (std::size_t i = 0; i < n; ++i) {
    // Clusters of all sizes, on both sides of zero.
    const int bits = static_cast<int>(random() % 32);
    const auto draw = [&] { return static_cast<std::int32_t>(random()) >> bits; };
    cells.push_back({draw(), draw(), draw()});
  }
  return cells;
}

struct Node {
  CellCode first;
  int level;
  std::uint64_t count;
  bool operator==(const Node&) const = default;
};

void SplitSlowly(const std::vector<CellCode>& codes, CellCode first, int level,
                 std::uint64_t tile_samples, int widest, std::vector<Node>& tiles) {
  std::vector<CellCode> inside;
  for (const CellCode c : codes) {
    if (c >= first && c - first < CellCode{1} << (3 * level)) inside.push_back(c);
  }
  if (inside.empty()) return;
  if (level == 0 || (inside.size() <= tile_samples && level <= widest)) {
    tiles.push_back({first, level, inside.size()});
    return;
  }
  for (CellCode child = 0; child < 8; ++child) {
    SplitSlowly(inside, first + (child << (3 * (level - 1))), level - 1, tile_samples, widest,
                tiles);
  }
}

std::vector<Node> Nodes(const std::vector<CellCode>& codes, OctreePlan plan) {
  do {
    for (const CellCode code : codes) EXPECT_TRUE(plan.Add(code));
    plan.Settle();
  } while (plan.unsettled());
  std::vector<Node> nodes;
  for (const OctreeNode& node : plan.nodes()) nodes.push_back({node.first, node.level, node.count});
  for (const CellCode code : codes) {
    const OctreeNode& node = plan.nodes()[plan.NodeOf(code)];
    EXPECT_TRUE(code >= node.first && code - node.first < CellCode{1} << (3 * node.level));
  }
  return nodes;
}

TEST(CodeOf, InterleavesTheBitsOfRaisedCoordinates) {
  for (const Cell cell : RandomCells(2000, 3)) ASSERT_TRUE(CodeOf(cell) == SlowCode(cell));
  for (const std::int32_t c : {INT32_MIN, -1, 0, INT32_MAX}) {
    EXPECT_TRUE(CodeOf({c, 0, -1}) == SlowCode({c, 0, -1}));
  }
  for (const Cell cell : RandomCells(2000, 4)) ASSERT_EQ(CellOfCode(CodeOf(cell)), cell);
}

TEST(CellAt, IsTheHalfOpenCellAndStaysWithinInt32) {
  EXPECT_EQ(CellAt({1.0, 0.999, -0.001}, {}, 0.5), (Cell{2, 1, -1}));
  EXPECT_EQ(CellAt({1.0, 1.0, 1.0}, {0.5, 1.0, 1.5}, 0.5), (Cell{1, 0, -1}));
  EXPECT_EQ(CellAt({1e300, -1e300, 0}, {}, 0.5), (Cell{INT32_MAX, INT32_MIN, 0}));
}

TEST(OctreePlan, EqualsTheOctreeFromWhateverLevelItStarts) {
  const std::uint64_t seed = 17;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::vector<CellCode> codes;
  for (const Cell cell : RandomCells(600, seed)) codes.push_back(CodeOf(cell));
  for (const std::uint64_t tile_samples : {1, 7, 100, 1000}) {
    for (const int widest : {0, 9, 31}) {
      std::vector<Node> expected;
      SplitSlowly(codes, 0, 32, tile_samples, widest, expected);
      for (const int start : {0, 1, 11, 30, 32}) {
        const OctreeLimits limits{.most = tile_samples, .widest_level = widest};
        ASSERT_TRUE(Nodes(codes, {limits, start}) == expected)
            << tile_samples << " " << widest << " " << start;
      }
    }
  }
}

TEST(OctreePlan, StartsWithAtMostSixtyFourNodesAcross) {
  for (const double side : {0.1, 1.0, 63.0, 64.0, 1e4, 1e9}) {
    const int level = OctreePlan::StartLevel({{}, {side, 0, side / 2}}, 0.5);
    EXPECT_LE(std::ldexp(side / 0.5, -level), 63);
    if (level > 0) {
      EXPECT_GT(std::ldexp(side / 0.5, 1 - level), 63);
    }
  }
}

// Dividing in two steps gives what one step does, as long as the first divides no further.
TEST(OctreePlan, DividesParcelsAsItDividesEverything) {
  std::vector<CellCode> codes;
  for (const Cell cell : RandomCells(600, 18)) codes.push_back(CodeOf(cell));
  const auto expected = Nodes(codes, {OctreeLimits{.most = 20}, 25});
  for (const std::uint64_t parcel : {20, 50, 300, 1000}) {
    OctreePlan parcels(OctreeLimits{.most = parcel}, 25);
    do {
      for (const CellCode code : codes) parcels.Add(code);
      parcels.Settle();
    } while (parcels.unsettled());
    EXPECT_TRUE(Nodes(codes, {OctreeLimits{.most = 20}, parcels.nodes()}) == expected) << parcel;
  }
}

TEST(OctreePlan, DoesNotCountOutsideItsRoots) {
  const OctreeNode root{CodeOf({8, 8, 8}), 3, 0};
  OctreePlan plan(OctreeLimits{.most = 1}, {&root, 1});
  EXPECT_TRUE(plan.Add(CodeOf({15, 8, 9})));
  for (const Cell cell : {Cell{16, 8, 8}, Cell{7, 8, 8}, Cell{-1, -1, -1}}) {
    EXPECT_FALSE(plan.Add(CodeOf(cell)));
  }
}

TEST(TouchesCube, EqualsLookingAtEveryCell) {
  std::mt19937_64 random(19);
  const auto small = [&] { return static_cast<std::int32_t>(random() % 40) - 20; };
  int touching = 0;
  for (int round = 0; round < 500; ++round) {
    std::vector<CellCode> codes;
    for (int n = 0; n < 4; ++n) codes.push_back(CodeOf({small(), small(), small()}));
    OctreePlan plan(OctreeLimits{.most = 1, .widest_level = 4, .finest_level = 2}, 10);
    do {
      for (const CellCode code : codes) plan.Add(code);
      plan.Settle();
    } while (plan.unsettled());
    const Cell low{small(), small(), small()};
    const auto wide = static_cast<std::int32_t>(random() % 9);
    const Cell high{low.x + wide, low.y + wide, low.z + wide};
    bool expected = false;
    for (std::int32_t x = low.x; x <= high.x; ++x) {
      for (std::int32_t y = low.y; y <= high.y; ++y) {
        for (std::int32_t z = low.z; z <= high.z; ++z) {
          expected |= FindNode(plan.nodes(), CodeOf({x, y, z})) < plan.nodes().size();
        }
      }
    }
    ASSERT_EQ(TouchesCube(plan.nodes(), low, high), expected) << "seed 19, round " << round;
    touching += expected ? 1 : 0;
  }
  EXPECT_GT(touching, 50);
  EXPECT_LT(touching, 450);
}

}  // namespace
}  // namespace strata
