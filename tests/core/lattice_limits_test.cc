// Lattices at the ends of what a double holds: a proper answer or a proper error.
#include <gtest/gtest.h>

#include <string>

#include "core/sample_mesh.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

Triangles Corner(double scale) {
  return {{Vec3{0, 0, 0}, Vec3{scale, 0, 0}, Vec3{0, scale, 0}},
          {Vec3{0, 0, 0}, Vec3{0, scale, 0}, Vec3{0, 0, scale}}};
}

Result<SampleResult> Sample(const Triangles& mesh, const LatticeSpec& lattice) {
  MemoryMesh reader(mesh);
  SampleOptions options;
  options.lattice = lattice;
  RunContext context;
  return SampleMesh(reader, options, context);
}

TEST(LatticeLimits, EveryOccupiedCellOfAnAllowedLatticeHasASampleWithANormal) {
  for (const double edge : {1e-60, 1e-30, 1.0, 1e30, 1e60}) {
    for (const double size : {1e-3, 1.0, 7.0}) {
      const auto result = Sample(Corner(edge * size), VoxelSize{edge});
      ASSERT_TRUE(result) << edge << ' ' << size << ": " << result.error().message;
      EXPECT_GT(result->samples.size(), 0u);
      for (const Vec3f& n : result->samples.normal) {
        EXPECT_NEAR(n.x * n.x + n.y * n.y + n.z * n.z, 1, 1e-6) << edge << ' ' << size;
      }
    }
  }
  // The smallest area that counts as one, in the largest cell.
  const auto speck = Sample(Corner(1e-80), VoxelSize{kMaxEdge});
  ASSERT_TRUE(speck) << speck.error().message;
  EXPECT_NE(speck->samples.normal[0], Vec3f{});
}

TEST(LatticeLimits, RefusesAnEdgeBeyondThem) {
  for (const double edge : {1e-300, 1e-61, 1e61, 1e154, 1e300, 0.0, -1.0, HUGE_VAL}) {
    const auto result = Sample(Corner(1), VoxelSize{edge});
    ASSERT_FALSE(result) << edge;
    EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument) << result.error().message;
  }
}

TEST(LatticeLimits, RefusesAMeshWhoseCellsWouldLieBeyondThem) {
  for (const double size : {1e-70, 1e70}) {
    for (const LatticeSpec& lattice : {LatticeSpec{Resolution{16}}, LatticeSpec{Height{5}}}) {
      const auto result = Sample(Corner(size), lattice);
      ASSERT_FALSE(result) << size;
      EXPECT_EQ(result.error().code, ErrorCode::kOverBudget) << result.error().message;
    }
  }
}

}  // namespace
}  // namespace strata::test
