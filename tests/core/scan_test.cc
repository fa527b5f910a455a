// What a scan does when it has to stop.
#include "core/scan.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>

#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

// Squares of `side` cells, one above the other.
Triangles Stack(int squares, double side) {
  Triangles mesh;
  for (int i = 0; i < squares; ++i) AddQuad(mesh, {0, 0, i + 0.5}, {side, 0, 0}, {0, side, 0});
  return mesh;
}

// Scans with room for 1000 cells; returns how many the grid held in the end.
std::size_t CellsAfterOverflow(const Triangles& mesh, Integrator integrator, int threads) {
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                  static_cast<std::size_t>(threads));
  tbb::task_arena arena(threads);
  MemoryMesh reader(mesh);
  StoreLimits limits;
  limits.max_cells = 1000;
  ReservoirStore store(limits);
  RunContext context;
  ScanOptions options;
  options.threads = threads;
  options.integrator = integrator;
  const auto totals = arena.execute([&] { return ScanTriangles(reader, options, store, context); });
  EXPECT_EQ(totals ? ErrorCode::kInternal : totals.error().code, ErrorCode::kOverBudget);
  return store.grid().size();
}

TEST(Scan, StopsSoonAfterTheGridIsFull) {
  // In all 40 million cells, 10 thousand a triangle, or one square of as many.
  for (const Triangles& mesh : {Stack(2000, 141), Stack(1, 6300)}) {
    for (const int threads : {1, 2}) {
      // What the threads' caches hold comes on top, twice: emptied when full and at the end.
      const std::size_t most = 1000 + static_cast<std::size_t>(threads) * (2 << 15) + 50'000;
      EXPECT_LE(CellsAfterOverflow(mesh, Integrator::kExact, threads), most)
          << mesh.size() << " triangles, " << threads << " threads";
    }
  }
}

TEST(Scan, StopsSoonAfterTheGridIsFullWhenSubdividing) {
  EXPECT_LE(CellsAfterOverflow(Stack(300, 141), Integrator::kSubdivide, 2), 200'000u);
}

}  // namespace
}  // namespace strata::test
