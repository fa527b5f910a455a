// Promise 3 where the code takes turns: triangles of every size side by side, needles, triangles
// flush with lattice planes or through the middles of cells, far from the origin, and so large that
// threads share one.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/samples_equal.h"

namespace strata::test {
namespace {

// Lengths are in cells: the lattice is that of the world with an edge of 1.
Triangle Plump(TestRandom& random, Vec3 at, double size) {
  Triangle t;
  for (Vec3& c : t) c = at + random.Direction() * (size * random.In(0.3, 1));
  return t;
}

Triangle Needle(TestRandom& random, Vec3 at, double length) {
  const Vec3 along = random.Direction() * length;
  const double width = length * random.LogIn(1e-13, 1e-2);
  return {at, at + along, at + along * random.Unit() + random.Direction() * width};
}

// Corners on a grid of halves: on lattice planes, on their crossings and in the middles of cells.
Triangle Flush(TestRandom& random, Vec3 at, double size) {
  Triangle t;
  const bool flat = random.Unit() < 0.6;
  const int axis = static_cast<int>(random.Below(3));
  for (Vec3& c : t) {
    c = at + random.InBox({-size, -size, -size}, {size, size, size});
    for (int a = 0; a < 3; ++a) c[a] = std::round(2 * c[a]) / 2;
    if (flat) c[axis] = std::round(2 * at[axis]) / 2;
  }
  return t;
}

// A needle along a ray from the middle of a cell, or through it.
Triangle Ray(TestRandom& random, Vec3 at) {
  const Vec3 center{std::floor(at.x) + 0.5, std::floor(at.y) + 0.5, std::floor(at.z) + 0.5};
  Vec3 along = random.Direction();
  if (random.Unit() < 0.5) along[static_cast<int>(random.Below(3))] = 0;
  Triangle t;
  for (Vec3& c : t) c = center + along * random.In(-0.5, 0.5);
  t[2] = t[2] + random.Direction() * random.LogIn(1e-17, 1e-3);
  return t;
}

Triangles EverySize(std::uint64_t seed, Vec3 offset, double most) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < 1500; ++i) {
    const Vec3 at = offset + random.InBox({-15, -15, -15}, {15, 15, 15});
    const double size = i % 150 == 0 ? random.In(40, most) : random.LogIn(1e-3, 12);
    switch (i % 5) {
      case 0:
        mesh.push_back(Plump(random, at, size));
        break;
      case 1:
        mesh.push_back(Needle(random, at, size));
        break;
      case 2:
        mesh.push_back(Flush(random, at, size));
        break;
      case 3:
        mesh.push_back(Ray(random, at));
        break;
      default:
        mesh.push_back(Plump(random, at, random.LogIn(1e-3, 1)));
    }
  }
  random.Shuffle(mesh);
  return mesh;
}

SampleResult Sample(const Triangles& mesh, const SampleOptions& options) {
  MemoryMesh reader(mesh);
  RunContext context;
  auto result = SampleMesh(reader, options, context);
  if (!result) {
    ADD_FAILURE() << result.error().message;
    return {};
  }
  return std::move(*result);
}

void ExpectSame(const SampleResult& expected, const SampleResult& result, const std::string& what) {
  EXPECT_TRUE(SameSamples(expected.samples, result.samples)) << what;
  EXPECT_TRUE(SameStats(expected.stats, result.stats)) << what;
}

// Every sample in its cell, every area counted.
void ExpectSound(const SampleResult& result) {
  const SampleStats& s = result.stats;
  EXPECT_NEAR(s.cell_area, s.mesh_area, 1e-6 * s.mesh_area);
  EXPECT_GE(s.pieces, s.cells);
  const double reach = std::max({std::fabs(s.bounds.min.x), std::fabs(s.bounds.max.x), 1.0});
  for (std::size_t i = 0; i < result.samples.size(); ++i) {
    const Cell cell = result.samples.cell[i];
    const Vec3 p = result.samples.position[i] - Vec3{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5};
    ASSERT_LE(std::max({std::fabs(p.x), std::fabs(p.y), std::fabs(p.z)}), 0.5 + 1e-15 * reach)
        << "sample " << i;
    const Vec3f n = result.samples.normal[i];
    ASSERT_NEAR(n.x * n.x + n.y * n.y + n.z * n.z, 1, 1e-5) << "normal of sample " << i;
  }
}

struct Case {
  Vec3 offset;
  double most, lambda;
};

class EverySizeOfTriangle : public testing::TestWithParam<Case> {
 protected:
  void TearDown() override { ASSERT_TRUE(ForceSimdTarget("auto")); }
};

TEST_P(EverySizeOfTriangle, Promise3GivesTheSameSamplesHoweverTheWorkIsDivided) {
  const Case& c = GetParam();
  const Triangles mesh = EverySize(77, c.offset, c.most);
  SampleOptions options;
  options.lattice = VoxelSize{1};
  options.lambda = c.lambda;
  options.attributes = kAllAttributes;
  options.min_distance = 0;
  options.seed = 5;
  options.threads = 1;
  const SampleResult expected = Sample(mesh, options);
  ASSERT_GT(expected.samples.size(), 1000u);
  ExpectSound(expected);
  for (const int threads : {1, 2, 3, 8}) {
    for (const std::size_t batch : {1, 7, 4096}) {
      options.threads = threads;
      options.batch_size = batch;
      ExpectSame(expected, Sample(mesh, options),
                 std::to_string(threads) + " threads, batches of " + std::to_string(batch));
    }
  }
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    ExpectSame(expected, Sample(mesh, options), target);
  }
  ASSERT_TRUE(ForceSimdTarget("auto"));
  TestRandom random(78);
  Triangles other = mesh;
  random.Shuffle(other);
  for (Triangle& t : other) {
    std::rotate(t.begin(), t.begin() + static_cast<long>(random.Below(3)), t.end());
  }
  ExpectSame(expected, Sample(other, options), "shuffled and rotated");
}

INSTANTIATE_TEST_SUITE_P(, EverySizeOfTriangle,
                         testing::Values(Case{{0, 0, 0}, 300, 5}, Case{{0, 0, 0}, 100, 0},
                                         Case{{0, 0, 0}, 100, 0.3}, Case{{0, 0, 0}, 100, 60},
                                         Case{{0, 0, 0}, 60, 500}, Case{{1e7, -1e7, 1e7}, 300, 5},
                                         Case{{1e7, -1e7, 1e7}, 60, 60},
                                         Case{{1e7, -1e7, 1e7}, 60, 500},
                                         Case{{1e9, 1e9, -1e9}, 60, 20}));

// Fine in the file's numbers near zero, on one line in numbers counted from a corner of the box.
Triangles NeedlesThinnerThanRounding() {
  Triangles mesh;
  for (const double length : {1.7, 3.3, 30.0, 300.0}) {  // Small, medium, large, very large.
    for (const Vec3& along : {Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}) {
      const Vec3 aside{1e-40 * along.y, 1e-40 * along.z, 1e-40 * along.x};
      mesh.push_back({Vec3{}, along * length, along * (0.5 * length) + aside});
    }
  }
  return mesh;
}

TEST(TrianglesThinnerThanRounding, Promise7AreCounted) {
  Triangles mesh = NeedlesThinnerThanRounding();
  const std::size_t needles = mesh.size();
  const Triangle plump = {Vec3{300, 0, 0}, Vec3{0, 300, 0}, Vec3{-1, -1, 300}};
  mesh.push_back(plump);
  for (const int threads : {1, 2}) {
    SampleOptions options;
    options.lattice = Resolution{301};
    options.threads = threads;
    const SampleResult result = Sample(mesh, options);
    EXPECT_EQ(result.stats.skipped[static_cast<std::size_t>(SkipReason::kZeroArea)], needles);
    EXPECT_EQ(result.stats.sampled, 1u);
    EXPECT_TRUE(SameSamples(result.samples, Sample({plump}, options).samples));
  }
}

TEST(TrianglesThinnerThanRounding, AloneAreAnEmptySurface) {
  MemoryMesh reader(NeedlesThinnerThanRounding());
  RunContext context;
  SampleOptions options;
  options.lattice = Resolution{301};
  const auto result = SampleMesh(reader, options, context);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kEmptySurface);
}

// The product of an area and of f in a cell's corner is below a double's range here.
TEST(TinyTriangles, GiveASampleOfTheirsAtAnyLambda) {
  for (const double lambda : {0.0, 5.0, 500.0}) {
    for (const double width : {0.4, 1.4, 30.0}) {
      const Triangle tiny = {Vec3{1e-75, 1e-75, 2e-75}, Vec3{1e-75 + width, 1e-75, 2e-75},
                             Vec3{1e-75, 1e-75 + 1e-75, 2e-75}};
      const Triangle dot = {Vec3{-1e-75, 1e-75, 2e-75}, Vec3{-2e-75, 1e-75, 2e-75},
                            Vec3{-1e-75, 3e-75, 2e-75}};
      SampleOptions options;
      options.lattice = VoxelSize{1};
      options.lambda = lambda;
      options.attributes = kAllAttributes;
      options.min_distance = 0;
      const SampleResult result = Sample({tiny, dot}, options);
      ASSERT_EQ(result.samples.size(), 1 + std::ceil(width));
      for (std::size_t i = 0; i < result.samples.size(); ++i) {
        EXPECT_EQ(std::fabs(result.samples.normal[i].z), 1) << "lambda " << lambda;
        EXPECT_EQ(result.samples.position[i].z, 2e-75);
      }
    }
  }
}

}  // namespace
}  // namespace strata::test
