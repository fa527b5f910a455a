// Promise 3 on a mesh of more cells than a worker's cache holds, where the order in which parts
// race and caches spill would show. tests/core/invariance_test.cc has the rest of the promise.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <numbers>
#include <random>

#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

double AsFloat(double v) { return static_cast<double>(static_cast<float>(v)); }

// A sphere of small triangles in a room of large ones, with slivers, some 60,000 cells in all: more
// than a worker's cache holds. All coordinates are floats.
Triangles MixedMesh() {
  Triangles mesh;
  const auto at = [](int i, int j) {
    const double u = i * std::numbers::pi / 60, v = j * std::numbers::pi / 30;
    return Vec3{AsFloat(std::sin(u) * std::cos(v)), AsFloat(std::sin(u) * std::sin(v)),
                AsFloat(std::cos(u))};
  };
  for (int i = 0; i < 60; ++i) {
    for (int j = 0; j < 60; ++j) {
      mesh.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      mesh.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  }
  const Vec3 low{-1.5, -1.25, -1.125}, high{1.5, 1.75, 1.375};
  mesh.push_back({low, {high.x, low.y, low.z}, {high.x, high.y, low.z}});
  mesh.push_back({low, {high.x, high.y, high.z}, {low.x, high.y, low.z}});
  std::mt19937_64 random(11);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (int i = 0; i < 300; ++i) {
    const Vec3 a{AsFloat(unit(random)), AsFloat(unit(random)), AsFloat(unit(random))};
    const Vec3 b{AsFloat(unit(random)), AsFloat(unit(random)), AsFloat(unit(random))};
    mesh.push_back({a, b, {AsFloat(b.x + 1e-4), b.y, AsFloat(b.z - 1e-5)}});
  }
  return mesh;
}

SampleOptions Options() {
  SampleOptions options;
  options.lattice = Resolution{150};
  options.attributes = kNormal | kCell | kArea;
  options.threads = 1;
  return options;
}

SampleResult SampleOf(Triangles mesh, const SampleOptions& options) {
  MemoryMesh reader(std::move(mesh), MemoryMesh::Vertices::kFloat);
  RunContext context;
  auto result = SampleMesh(reader, options, context);
  EXPECT_TRUE(result) << result.error().message;
  return std::move(*result);
}

void ExpectSame(const SampleResult& a, const SampleResult& b, const std::string& what) {
  SCOPED_TRACE(what);
  EXPECT_EQ(a.stats.surface_hash, b.stats.surface_hash);
  EXPECT_EQ(a.stats.cells, b.stats.cells);
  EXPECT_EQ(a.stats.pieces, b.stats.pieces);
  EXPECT_EQ(a.stats.cell_area, b.stats.cell_area);
  ASSERT_EQ(a.samples.size(), b.samples.size());
  EXPECT_TRUE(a.samples.position == b.samples.position);
  EXPECT_TRUE(a.samples.normal == b.samples.normal);
  EXPECT_TRUE(a.samples.cell == b.samples.cell);
  EXPECT_TRUE(a.samples.area == b.samples.area);
}

class Promise3SameSamples : public ::testing::TestWithParam<double> {
 protected:
  SampleOptions options() const {
    SampleOptions o = Options();
    o.lambda = GetParam();
    return o;
  }
};
INSTANTIATE_TEST_SUITE_P(Lambda, Promise3SameSamples, ::testing::Values(0, 5, 60));

TEST_P(Promise3SameSamples, ForAnyNumberOfThreads) {
  const SampleResult one = SampleOf(MixedMesh(), options());
  ASSERT_GT(one.stats.cells, 40'000u) << "the mesh should spill the workers' caches";
  for (const int threads : {2, 3, 8}) {
    SampleOptions o = options();
    o.threads = threads;
    ExpectSame(one, SampleOf(MixedMesh(), o), std::to_string(threads) + " threads");
  }
}

TEST_P(Promise3SameSamples, ForAnyBatchSize) {
  const SampleResult usual = SampleOf(MixedMesh(), options());
  for (const std::size_t batch : {1u, 7u, 4096u}) {
    SampleOptions o = options();
    o.batch_size = batch;
    ExpectSame(usual, SampleOf(MixedMesh(), o), "batches of " + std::to_string(batch));
  }
}

TEST_P(Promise3SameSamples, ForAnyOrderOfTriangles) {
  const SampleResult ordered = SampleOf(MixedMesh(), options());
  for (const std::uint64_t seed : {1u, 2u}) {
    std::printf("seed %llu\n", static_cast<unsigned long long>(seed));
    Triangles mesh = MixedMesh();
    std::shuffle(mesh.begin(), mesh.end(), std::mt19937_64(seed));
    ExpectSame(ordered, SampleOf(mesh, options()), "shuffled");
  }
}

TEST_P(Promise3SameSamples, ForEveryInstructionSet) {
  const SampleResult best = SampleOf(MixedMesh(), options());
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    ExpectSame(best, SampleOf(MixedMesh(), options()), target);
  }
  ASSERT_TRUE(ForceSimdTarget("auto"));
}

TEST(Promise3SameSamplesWhen, OneTriangleOfFourMillionCellsIsSharedAmongThreads) {
  SampleOptions options = Options();
  options.lattice = VoxelSize{1};
  options.min_distance = 0;
  options.attributes = kCell;
  const Triangles mesh = {{Vec3{0.3, 0.2, 0.1}, Vec3{2900.7, 10.3, 40.1}, Vec3{5.5, 2700.9, 90.2}}};
  const SampleResult one = SampleOf(mesh, options);
  EXPECT_GT(one.stats.cells, 3'900'000u);
  options.threads = 2;
  ExpectSame(one, SampleOf(mesh, options), "2 threads");
}

}  // namespace
}  // namespace strata::test
