// The plan against an octree built the plain way: top down, with every cell at hand.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>
#include <string>

#include "io/tile_plan.h"

namespace strata::io {
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

std::vector<Node> Tiles(const std::vector<CellCode>& codes, TilePlan plan) {
  for (const CellCode code : codes) plan.Add(code);
  for (plan.Settle(); plan.unsettled(); plan.Settle()) {
    for (const CellCode code : codes) plan.Recount(code);
  }
  std::vector<Node> nodes;
  for (const TileNode& tile : plan.tiles()) {
    nodes.push_back({tile.first, tile.level, tile.count});
    EXPECT_FALSE(tile.unsettled);
  }
  for (const CellCode code : codes) {
    const TileNode& tile = plan.tiles()[plan.TileOf(code)];
    EXPECT_TRUE(code >= tile.first && code - tile.first < CellCode{1} << (3 * tile.level));
  }
  return nodes;
}

TEST(CodeOf, InterleavesTheBitsOfRaisedCoordinates) {
  for (const Cell cell : RandomCells(2000, 3)) ASSERT_TRUE(CodeOf(cell) == SlowCode(cell));
  for (const std::int32_t c : {INT32_MIN, -1, 0, INT32_MAX}) {
    EXPECT_TRUE(CodeOf({c, 0, -1}) == SlowCode({c, 0, -1}));
  }
}

TEST(CellAt, IsTheHalfOpenCellAndStaysWithinInt32) {
  EXPECT_EQ(CellAt({1.0, 0.999, -0.001}, {}, 0.5), (Cell{2, 1, -1}));
  EXPECT_EQ(CellAt({1.0, 1.0, 1.0}, {0.5, 1.0, 1.5}, 0.5), (Cell{1, 0, -1}));
  EXPECT_EQ(CellAt({1e300, -1e300, 0}, {}, 0.5), (Cell{INT32_MAX, INT32_MIN, 0}));
}

TEST(TilePlan, EqualsTheOctreeFromWhateverLevelItStarts) {
  const std::uint64_t seed = 17;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::vector<CellCode> codes;
  for (const Cell cell : RandomCells(600, seed)) codes.push_back(CodeOf(cell));
  for (const std::uint64_t tile_samples : {1, 7, 100, 1000}) {
    for (const int widest : {0, 9, 31}) {
      std::vector<Node> expected;
      SplitSlowly(codes, 0, 32, tile_samples, widest, expected);
      for (const int start : {0, 1, 11, 30, 32}) {
        ASSERT_TRUE(Tiles(codes, {tile_samples, widest, start}) == expected)
            << tile_samples << " " << widest << " " << start;
      }
    }
  }
}

TEST(TilePlan, StartsWithAtMostSixtyFourNodesAcross) {
  for (const double side : {0.1, 1.0, 63.0, 64.0, 1e4, 1e9}) {
    const int level = TilePlan::StartLevel({{}, {side, 0, side / 2}}, 0.5);
    EXPECT_LE(std::ldexp(side / 0.5, -level), 63);
    if (level > 0) {
      EXPECT_GT(std::ldexp(side / 0.5, 1 - level), 63);
    }
  }
}

}  // namespace
}  // namespace strata::io
