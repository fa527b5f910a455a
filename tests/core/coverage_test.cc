// Promise 5: every surface point is within sqrt(3) e of a sample before rejection, and within
// (sqrt(3) + m) e after: on the scans, for m up to 1/2 (docs/adr/0007).
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <string>
#include <unordered_map>

#include "core/random_stream.h"
#include "core/sample_mesh.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/scans.h"

namespace strata::test {
namespace {

// Finds the nearest of many points.
class NearestPoint {
 public:
  NearestPoint(const std::vector<Vec3>& points, double cell) : points_(points), cell_(cell) {
    for (std::size_t i = 0; i < points.size(); ++i) buckets_[KeyOf(CellOf(points[i]))].push_back(i);
  }
  // Distance of the nearest point, if that is within 2 cells; else infinity.
  double DistanceTo(Vec3 p) const {
    const Cell at = CellOf(p);
    double best2 = HUGE_VAL;
    for (int x = -2; x <= 2; ++x) {
      for (int y = -2; y <= 2; ++y) {
        for (int z = -2; z <= 2; ++z) {
          const auto found = buckets_.find(KeyOf({at.x + x, at.y + y, at.z + z}));
          if (found == buckets_.end()) continue;
          for (const std::size_t i : found->second) best2 = std::min(best2, Norm2(points_[i] - p));
        }
      }
    }
    return std::sqrt(best2);
  }

 private:
  Cell CellOf(Vec3 p) const {
    const auto at = [&](double v) { return static_cast<std::int32_t>(std::floor(v / cell_)); };
    return {at(p.x), at(p.y), at(p.z)};
  }
  static std::uint64_t KeyOf(Cell c) {
    const auto part = [](std::int32_t v) { return static_cast<std::uint64_t>(v) & 0x1fffff; };
    return part(c.x) << 42 | part(c.y) << 21 | part(c.z);
  }
  const std::vector<Vec3>& points_;
  double cell_;
  std::unordered_map<std::uint64_t, std::vector<std::size_t>> buckets_;
};

// Corners, centroid and a few random points of every triangle with an area.
std::vector<Vec3> SurfacePoints(const Triangles& mesh, std::size_t stride) {
  TestRandom random(61);
  std::vector<Vec3> points;
  for (std::size_t i = 0; i < mesh.size(); i += stride) {
    const Triangle& t = mesh[i];
    if (!(Norm2(Cross(t[1] - t[0], t[2] - t[0])) > 0)) continue;
    points.insert(points.end(), t.begin(), t.end());
    points.push_back((t[0] + t[1] + t[2]) * (1.0 / 3));
    for (int k = 0; k < 3; ++k) {
      double u = random.Unit(), v = random.Unit();
      if (u + v > 1) u = 1 - u, v = 1 - v;
      points.push_back(t[0] + (t[1] - t[0]) * u + (t[2] - t[0]) * v);
    }
  }
  return points;
}

void ExpectCovered(const Triangles& mesh, std::size_t stride, LatticeSpec lattice) {
  const std::vector<Vec3> surface = SurfacePoints(mesh, stride);
  for (const double m : {0.0, 0.3, 0.5}) {
    for (const double lambda : {0.0, 5.0}) {
      SampleOptions options;
      options.lattice = lattice;
      options.min_distance = m;
      options.lambda = lambda;
      MemoryMesh reader(mesh);
      RunContext context;
      const auto result = SampleMesh(reader, options, context);
      ASSERT_TRUE(result) << result.error().message;
      const double edge = result->stats.lattice.edge, reach = (std::sqrt(3.0) + m) * edge;
      const NearestPoint nearest(result->samples.position, reach / 2);
      double furthest = 0;
      for (const Vec3& p : surface) furthest = std::max(furthest, nearest.DistanceTo(p));
      EXPECT_LE(furthest, reach * (1 + 1e-9)) << "m " << m << ", lambda " << lambda;
      std::printf("m %g, lambda %g: no surface point is further than %.3f edges, promised %.3f\n",
                  m, lambda, furthest / edge, reach / edge);
    }
  }
}

void ExpectScanCovered(const std::string& name, std::size_t stride, LatticeSpec lattice) {
  STRATA_SCAN_OR_SKIP(path, name);
  const auto reader = OpenScan(path);
  ASSERT_NE(reader, nullptr);
  ExpectCovered(ReadTriangles(*reader), stride, lattice);
}

TEST(Promise5Coverage, HoldsOnTheBunny) { ExpectScanCovered("bun_zipper.ply", 3, Resolution{64}); }
TEST(Promise5Coverage, HoldsOnTheDragon) {
  ExpectScanCovered("dragon_vrip_res2.ply.gz", 8, Height{7});
}
TEST(Promise5Coverage, HoldsOnTheArmadillo) {
  ExpectScanCovered("armadillo.obj", 5, Resolution{80});
}
TEST(Promise5Coverage, HoldsOnTheFandisk) { ExpectScanCovered("fandisk.obj", 1, Height{6}); }
TEST(Promise5Coverage, HoldsOnTheTeapot) { ExpectScanCovered("teapot.obj", 1, Resolution{100}); }

TEST(Promise5Coverage, HoldsOnNeedlesAndFlakes) {
  TestRandom random(62);
  Triangles mesh;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 at = random.InBox({-5, -5, -5}, {5, 5, 5});
    const Vec3 along = random.Direction() * random.LogIn(1e-3, 6);
    const Vec3 across = random.Direction() * random.LogIn(1e-6, 1);
    mesh.push_back({at, at + along, at + across});
  }
  ExpectCovered(mesh, 1, VoxelSize{0.5});
}

// A needle is surface too, however thin, as long as it has an area.
TEST(Promise5Coverage, HoldsOnASingleNeedleOfAnyWidth) {
  for (const double width : {1e-3, 1e-6, 1e-9, 1e-11, 1e-13, 1e-15, 1e-17, 1e-30, 1e-100}) {
    for (const double length : {0.5, 1.5, 3.0, 200.0, 3000.0}) {
      for (const double lambda : {0.0, 5.0, 60.0, 500.0}) {
        // Along an axis, where rounding takes nothing from the width.
        const Triangles mesh = {
            {Vec3{0.1, 0, 0.25}, Vec3{0.1 + length, 0, 0.25}, Vec3{0.3, width, 0.25}}};
        SampleOptions options;
        options.lattice = VoxelSize{1};
        options.min_distance = 0;
        options.lambda = lambda;
        MemoryMesh reader(mesh);
        RunContext context;
        const auto result = SampleMesh(reader, options, context);
        ASSERT_TRUE(result) << result.error().message;
        const std::string trace = "width " + std::to_string(std::log10(width)) + ", length " +
                                  std::to_string(length) + ", lambda " + std::to_string(lambda);
        EXPECT_GE(static_cast<double>(result->samples.size()), length - 1) << trace;
        for (std::size_t i = 0; i < result->samples.size(); ++i) {
          EXPECT_NEAR(std::fabs(result->samples.normal[i].z), 1, 1e-6) << trace;
          EXPECT_NEAR(result->samples.position[i].y, 0, 1e-3) << trace;
          EXPECT_NEAR(result->samples.position[i].z, 0.25, 1e-12) << trace;
        }
        if (HasFailure()) return;
      }
    }
  }
}

}  // namespace
}  // namespace strata::test
