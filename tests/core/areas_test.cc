// Promise 7, its last part: the areas of all cells add up to the area of the mesh.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

// A mesh over a lattice of edge 1 at the origin, and what it stands for.
struct NamedMesh {
  std::string name;
  Triangles mesh;
};

Triangle RandomTriangle(double size, Vec3 at, TestRandom& random) {
  Triangle t;
  for (Vec3& c : t) c = at + random.Direction() * (size * random.In(0.5, 1));
  return t;
}

// Triangles of sizes between two bounds; fewer of the large ones, which cover many cells.
Triangles OfSizes(double least, double most, Vec3 offset, std::uint64_t seed) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < 2000; ++i) {
    const double size = random.LogIn(least, most);
    if (size > 30 && i % 400 != 0) continue;
    mesh.push_back(
        RandomTriangle(size, offset + random.InBox({-20, -20, -20}, {20, 20, 20}), random));
  }
  return mesh;
}

// Corners on lattice points, triangles partly in lattice planes.
Triangles OnLatticePoints(std::uint64_t seed) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < 1500; ++i) {
    Triangle t;
    const int reach = i % 3 == 0 ? 12 : 3;
    for (Vec3& c : t) {
      for (int a = 0; a < 3; ++a) c[a] = static_cast<double>(random.Below(reach)) - 1;
    }
    if (i % 4 == 0) t[1].z = t[2].z = t[0].z;
    mesh.push_back(t);
  }
  return mesh;
}

// Corners on lattice edges and faces, or just off them.
Triangles NearLatticePlanes(std::uint64_t seed) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < 1500; ++i) {
    Triangle t =
        RandomTriangle(random.LogIn(0.1, 5), random.InBox({-3, -3, -3}, {3, 3, 3}), random);
    for (Vec3& c : t) {
      for (int a = 0; a < 3; ++a) {
        if (random.Unit() < 0.5) c[a] = std::round(c[a]);
        if (random.Unit() < 0.2) c[a] = std::nextafter(c[a], random.Unit() < 0.5 ? -9 : 9);
      }
    }
    mesh.push_back(t);
  }
  return mesh;
}

Triangles Needles(std::uint64_t seed) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < 400; ++i) {
    const Vec3 at = random.InBox({-5, -5, -5}, {5, 5, 5});
    const Vec3 along = random.Direction() * random.LogIn(0.1, 100);
    const Vec3 across = random.Direction() * random.LogIn(1e-5, 1e-2);
    mesh.push_back({at, at + along, at + along * random.Unit() + across});
  }
  return mesh;
}

std::vector<NamedMesh> Meshes() {
  constexpr double kFar = 1e7;
  return {
      {"triangles of 1e-3 to 1e3 cells", OfSizes(1e-3, 1e3, {}, 31)},
      {"small triangles", OfSizes(1e-3, 1e-2, {}, 32)},
      {"triangles of about a cell", OfSizes(0.3, 3, {}, 33)},
      {"triangles of 1e-3 to 1e3 cells, 1e7 cells off",
       OfSizes(1e-3, 1e3, {kFar, -kFar, kFar}, 34)},
      {"triangles of about a cell, 1e7 cells off", OfSizes(0.3, 3, {-kFar, kFar, 0}, 35)},
      {"corners on lattice points", OnLatticePoints(36)},
      {"corners on lattice planes", NearLatticePlanes(37)},
      {"needles", Needles(38)},
      {"a box flush with the lattice", BoxMesh({-2, 0, 1}, {3, 2, 4})},
      {"a box flush with the lattice, 1e7 cells off", BoxMesh({kFar, 0, 1}, {kFar + 30, 2, 4})},
      {"one large triangle", {{Vec3{-700, 0.1, 0.2}, Vec3{900, 30, 100}, Vec3{50, 800, -333.3}}}},
      {"one triangle in a lattice plane", {{Vec3{-7, 3, 0.2}, Vec3{9, 3, 10}, Vec3{50, 3, -33}}}},
  };
}

Result<SampleResult> Sample(const Triangles& mesh) {
  MemoryMesh reader(mesh);
  SampleOptions options;
  options.lattice = VoxelSize{1};
  options.min_distance = 0;
  options.attributes = kArea | kCell;
  RunContext context;
  return SampleMesh(reader, options, context);
}

class CellAreas : public testing::Test {
 protected:
  void TearDown() override { ASSERT_TRUE(ForceSimdTarget("auto")); }
};

TEST_F(CellAreas, Promise7AddUpToTheAreaOfTheMesh) {
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    for (const NamedMesh& m : Meshes()) {
      SCOPED_TRACE(m.name + ", " + target);
      long double area = 0;
      for (const Triangle& t : m.mesh) area += 0.5L * Norm(Cross(t[1] - t[0], t[2] - t[0]));
      const auto result = Sample(m.mesh);
      ASSERT_TRUE(result) << result.error().message;
      const double expected = static_cast<double>(area);
      EXPECT_NEAR(result->stats.mesh_area, expected, 1e-9 * expected);
      EXPECT_NEAR(result->stats.cell_area, expected, 1e-6 * expected);
      double sum = 0;
      for (const double a : result->samples.area) sum += a;
      EXPECT_NEAR(sum, expected, 1e-6 * expected);
    }
  }
}

// Its extent rounds to two cells, but it reaches into four.
TEST_F(CellAreas, OfATriangleJustOverTwoCellsWideAddUp) {
  const Triangles mesh = {{Vec3{-3.0000000000000004, -1.059233253130077, 2},
                           Vec3{-1.9999999999999998, -0.13584874707405151, 0.83985546906091313},
                           Vec3{-3, -0.084755486070185571, 0.91326122382285735}}};
  const auto result = Sample(mesh);
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_NEAR(result->stats.cell_area, result->stats.mesh_area, 1e-9);
}

// Each cell's share, too: on a plane through the centres every cell holds one face.
TEST_F(CellAreas, AreOneFaceOnAPlaneThroughTheCentres) {
  Triangles mesh;
  AddQuad(mesh, {0, 0, 0.5}, {40, 0, 0}, {0, 40, 0});
  const auto result = Sample(mesh);
  ASSERT_TRUE(result) << result.error().message;
  ASSERT_EQ(result->samples.size(), 1600u);
  for (const double a : result->samples.area) EXPECT_NEAR(a, 1, 1e-12);
}

}  // namespace
}  // namespace strata::test
