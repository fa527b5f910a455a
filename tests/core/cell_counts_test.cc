// Promise 2 on the paper's lattice: the numbers of occupied cells of its Table 1 and of the design.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>

#include "core/sample_mesh.h"
#include "tests/support/scans.h"

namespace strata::test {
namespace {

constexpr std::array<std::uint32_t, 3> kHeights = {5, 6, 7};
using Counts = std::array<double, 3>;

void ExpectCells(const std::filesystem::path& path, Integrator integrator, const Counts& expected) {
  const auto reader = OpenScan(path);
  ASSERT_NE(reader, nullptr);
  for (std::size_t i = 0; i < kHeights.size(); ++i) {
    SampleOptions options;
    options.lattice = Height{kHeights[i]};
    options.min_distance = 0;
    options.integrator = integrator;
    RunContext context;
    ASSERT_TRUE(reader->Rewind());
    const auto result = SampleMesh(*reader, options, context);
    ASSERT_TRUE(result) << result.error().message;
    const auto cells = static_cast<double>(result->stats.cells);
    std::printf("%s, height %u: %.0f cells, expected %.0f\n", path.filename().c_str(), kHeights[i],
                cells, expected[i]);
    EXPECT_LE(std::fabs(cells - expected[i]), 0.003 * expected[i]) << "height " << kHeights[i];
    EXPECT_EQ(result->samples.size(), result->stats.cells);
  }
}

TEST(Promise2OnePerOccupiedCell, BunnyHasTheDesignsCells) {
  STRATA_SCAN_OR_SKIP(path, "bun_zipper.ply");
  ExpectCells(path, Integrator::kExact, {482, 2063, 8387});
}

TEST(Promise2OnePerOccupiedCell, DragonHasTheDesignsCells) {
  STRATA_SCAN_OR_SKIP(path, "dragon_vrip.ply.gz");
  ExpectCells(path, Integrator::kExact, {543, 2279, 9519});
}

TEST(Promise2OnePerOccupiedCell, SubdividedBunnyHasThePapersCells) {
  STRATA_SCAN_OR_SKIP(path, "bun_zipper.ply");
  ExpectCells(path, Integrator::kSubdivide, {497, 2062, 8401});
}

TEST(Promise2OnePerOccupiedCell, SubdividedDragonHasThePapersCells) {
  STRATA_SCAN_OR_SKIP(path, "dragon_vrip.ply.gz");
  ExpectCells(path, Integrator::kSubdivide, {549, 2350, 9806});
}

}  // namespace
}  // namespace strata::test
