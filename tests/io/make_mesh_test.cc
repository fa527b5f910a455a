#include "tests/support/make_mesh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "io/open_mesh.h"
#include "tests/support/read_mesh.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

TEST(MakeMesh, PermutesEveryNumberOnceAndBack) {
  for (const std::uint64_t n : {1, 2, 5, 64, 1000, 4097}) {
    for (const std::uint64_t seed : {0, 1}) {
      const Permutation moved(n, seed);
      std::vector<bool> seen(n);
      for (std::uint64_t i = 0; i < n; ++i) {
        const std::uint64_t to = moved(i);
        ASSERT_LT(to, n);
        EXPECT_FALSE(seen[to]);
        seen[to] = true;
        EXPECT_EQ(moved.Inverse(to), i);
      }
    }
  }
  const Permutation large(std::uint64_t{3} << 32, 9);
  EXPECT_EQ(large.Inverse(large(12345678901)), 12345678901u);
}

std::vector<std::array<Vec3, 3>> TrianglesOf(const std::string& path) {
  auto mesh = ReadWhole(io::OpenMesh(path));
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? mesh->triangles : std::vector<std::array<Vec3, 3>>{};
}

TEST(MakeMesh, WritesTheSameTrianglesInEveryFormatAndOrder) {
  const TempFolder folder;
  const ComputedMesh sphere = FractalSphere(2000);
  EXPECT_NEAR(static_cast<double>(sphere.triangles), 2000, 100);
  ASSERT_TRUE(WriteMesh(sphere, MeshFormat::kPly, folder / "plain.ply"));
  const auto expected = TrianglesOf(folder / "plain.ply");
  EXPECT_EQ(expected.size(), sphere.triangles);
  for (const std::string name : {"ply", "ply-ascii", "stl", "obj"}) {
    for (const ComputedMesh& mesh : {sphere, Shuffled(sphere, 3)}) {
      ASSERT_TRUE(WriteMesh(mesh, *MeshFormatNamed(name), folder / "mesh"));
      EXPECT_TRUE(TrianglesOf(folder / "mesh") == expected) << name;
    }
  }
  EXPECT_FALSE(MeshFormatNamed("off"));
  EXPECT_FALSE(WriteMesh(sphere, MeshFormat::kPly, folder / "no/such/folder"));
}

TEST(MakeMesh, TilesAScan) {
  const TempFolder folder;
  const ComputedMesh sphere = FractalSphere(500);
  ASSERT_TRUE(WriteMesh(sphere, MeshFormat::kPly, folder / "scan.ply"));
  const auto scan = ScanFromPly(folder / "scan.ply");
  ASSERT_TRUE(scan) << scan.error().message;
  ASSERT_EQ(scan->triangles, sphere.triangles);
  const ComputedMesh tiled = Tiled(*scan, 3 * scan->triangles + 7);
  ASSERT_TRUE(WriteMesh(tiled, MeshFormat::kPly, folder / "tiled.ply"));
  const auto triangles = TrianglesOf(folder / "tiled.ply");
  ASSERT_EQ(triangles.size(), 3 * scan->triangles + 7);
  const auto first = TrianglesOf(folder / "scan.ply");
  EXPECT_TRUE(std::equal(first.begin(), first.end(), triangles.begin()));
  const double step = triangles[first.size()][0].x - first[0][0].x;
  EXPECT_GT(step, 2);
  ASSERT_TRUE(WriteMesh(sphere, MeshFormat::kPlyAscii, folder / "ascii.ply"));
  EXPECT_FALSE(ScanFromPly(folder / "ascii.ply"));
}

}  // namespace
}  // namespace strata::test
