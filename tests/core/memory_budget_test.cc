// Promise 3 and 6: a smaller budget changes where reservoirs lie, not the samples.
#include <gtest/gtest.h>

#include <string>

#include "core/sample_mesh.h"
#include "core/scan.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/samples_equal.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

// A sheet of hills, a needle and one triangle over many cells.
Triangles Landscape(int side) {
  Triangles mesh;
  const auto at = [&](int i, int j) {
    return Vec3{0.9 * i, 0.9 * j, 3 * std::sin(i * 0.3) * std::cos(j * 0.2)};
  };
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      mesh.push_back({at(i, j), at(i + 1, j), at(i, j + 1)});
      mesh.push_back({at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  }
  const double far = side;
  mesh.push_back({Vec3{0, 0, 9}, Vec3{far, 0.5, 40}, Vec3{0.3, far, 77}});
  mesh.push_back({Vec3{0, 0, -9}, Vec3{far, far, -9.001}, Vec3{far, far - 0.01, -9}});
  return mesh;
}

SampleOptions Options() {
  SampleOptions options;
  options.lattice = VoxelSize{1};
  options.attributes = kAllAttributes;
  options.threads = 2;
  return options;
}

Result<SampleResult> Sample(const Triangles& mesh, const SampleOptions& options,
                            std::uint64_t budget, ScratchFolder* scratch) {
  MemoryMesh reader(mesh);
  RunContext context(budget);
  context.SetScratch(scratch);
  return SampleMesh(reader, options, context);
}

TEST(MemoryBudget, Promise3SamplesDoNotDependOnIt) {
  const Triangles mesh = Landscape(350);
  TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch);
  const std::uint64_t worker = WorkerBytes(2048, 2);
  for (const double m : {0.0, 0.5, 0.8}) {
    SampleOptions options = Options();
    options.min_distance = m;
    const auto expected = Sample(mesh, options, MemoryAccount::kUnlimited, nullptr);
    ASSERT_TRUE(expected) << expected.error().message;
    EXPECT_GT(expected->stats.cells, 100000u);
    for (const std::uint64_t budget : {2 * worker, 3 * worker, 6 * worker, 100 * worker}) {
      for (const int threads : {1, 2, 3}) {
        SCOPED_TRACE("m " + std::to_string(m) + ", budget " + std::to_string(budget) +
                     ", threads " + std::to_string(threads));
        options.threads = threads;
        const auto result = Sample(mesh, options, budget, scratch->get());
        ASSERT_TRUE(result) << result.error().message;
        EXPECT_TRUE(SameSamples(expected->samples, result->samples));
        EXPECT_TRUE(SameStats(expected->stats, result->stats));
      }
    }
  }
  EXPECT_TRUE(folder.List().empty());
}

TEST(MemoryBudget, SubdividedSamplesDoNotDependOnIt) {
  const Triangles mesh = Landscape(120);
  TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  SampleOptions options = Options();
  options.integrator = Integrator::kSubdivide;
  options.min_distance = 0;
  const auto expected = Sample(mesh, options, MemoryAccount::kUnlimited, nullptr);
  const auto result = Sample(mesh, options, 2 * WorkerBytes(2048, 2), scratch->get());
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_TRUE(SameSamples(expected->samples, result->samples));
}

TEST(MemoryBudget, TooSmallForAWorkerIsRefusedWithWhatItNeeds) {
  const auto result = Sample(Landscape(3), Options(), 1 << 20, nullptr);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(result.error().message.find(std::to_string(2 * WorkerBytes(2048, 2))),
            std::string::npos)
      << result.error().message;
}

TEST(MemoryBudget, WithoutScratchSpaceTooManyCellsAreRefused) {
  const auto result = Sample(Landscape(350), Options(), 2 * WorkerBytes(2048, 2), nullptr);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(result.error().message.find("scratch space"), std::string::npos)
      << result.error().message;
}

}  // namespace
}  // namespace strata::test
