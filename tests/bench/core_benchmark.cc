// What the hot pieces of core/ cost, each alone, for every vector instruction set this processor
// has.
//
// items_per_second counts triangles, pieces or points. Run with --benchmark_filter=… for a few.
#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "core/mesh_reader.h"
#include "core/polygon.h"
#include "core/race.h"
#include "core/random_stream.h"
#include "core/rejection.h"
#include "core/run_context.h"
#include "core/scan_kernel.h"
#include "core/simd_target.h"

namespace strata {
namespace {

constexpr std::size_t kBatch = 2048;
constexpr std::size_t kSplitChunk = 512;  // As the scan does it.
constexpr std::uint64_t kSeed = 7;

double Uniform(std::mt19937_64& random) { return static_cast<double>(random() >> 11) * 0x1p-53; }

Vec3 UniformVec(std::mt19937_64& random) {
  const double x = Uniform(random), y = Uniform(random);
  return {x, y, Uniform(random)};
}

/// A batch of triangles with corners in cubes of side `size` cells, all over 64^3 cells.
TriangleBatch RandomTriangles(double size) {
  std::mt19937_64 random(kSeed);
  TriangleBatch batch(kBatch);
  for (std::uint64_t i = 0; i < kBatch; ++i) {
    const Vec3 at = UniformVec(random) * 64;
    const Vec3 a = at + UniformVec(random) * size, b = at + UniformVec(random) * size;
    batch.Push(a, b, at + UniformVec(random) * size, i);
  }
  return batch;
}

void Force(const std::string& target) {
  if (const auto forced = ForceSimdTarget(target); !forced) {
    std::fprintf(stderr, "%s\n", forced.error().message.c_str());
    std::exit(1);
  }
}

void CountItems(benchmark::State& state, std::size_t each) {
  state.SetItemsProcessed(static_cast<std::int64_t>(each) * state.iterations());
}

void BM_ClassifyTriangles(benchmark::State& state, const std::string& target, double size) {
  Force(target);
  const TriangleBatch batch = RandomTriangles(size);
  const ScanParameters parameters;
  TriangleLanes lanes(kBatch);
  for (auto _ : state) {
    ClassifyTriangles(batch, parameters, lanes);
    benchmark::ClobberMemory();
  }
  CountItems(state, kBatch);
  state.counters["inside"] = static_cast<double>(lanes.inside_size) / kBatch;
}

void BM_SplitTriangles(benchmark::State& state, const std::string& target, double size) {
  Force(target);
  const TriangleBatch batch = RandomTriangles(size);
  const ScanParameters parameters;
  TriangleLanes lanes(kBatch);
  ClassifyTriangles(batch, parameters, lanes);
  SplitQueue scratch(9 * kSplitChunk), scratch2(9 * kSplitChunk);
  SplitParts parts(27 * kSplitChunk);
  const std::size_t count = std::min(kSplitChunk, lanes.small.size);
  for (auto _ : state) {
    SplitTriangles(lanes.small, 0, count, parameters, scratch, scratch2, parts);
    benchmark::ClobberMemory();
  }
  CountItems(state, count);
  state.counters["parts"] = static_cast<double>(parts.geometry.size) / static_cast<double>(count);
}

/// A triangle of the given legs, its right angle at a random place of its cell.
struct Piece {
  Polygon polygon;
  Vec3 normal;
  double area;
};
std::vector<Piece> RandomPieces(double leg) {
  std::mt19937_64 random(kSeed);
  std::vector<Piece> pieces;
  for (std::size_t i = 0; i < kBatch; ++i) {
    const Vec3 a = UniformVec(random) * (1 - leg) - Vec3{0.5, 0.5, 0.5};
    const double tilt = 0.6 * leg;
    Piece piece;
    for (const Vec3& step : {Vec3{}, Vec3{leg, 0, tilt}, Vec3{0, leg, 0}}) {
      piece.polygon.Push(a + step);
    }
    const Vec3 n = Cross(piece.polygon[1] - a, piece.polygon[2] - a);
    piece.area = 0.5 * Norm(n);
    piece.normal = n * (1 / Norm(n));
    pieces.push_back(piece);
  }
  return pieces;
}

void BM_DrawFirstArrival(benchmark::State& state, double lambda, double leg) {
  const std::vector<Piece> pieces = RandomPieces(leg);
  for (auto _ : state) {
    for (std::size_t i = 0; i < kBatch; ++i) {
      const RandomStream random(kSeed, i, {1, 2, 3}, 0);
      benchmark::DoNotOptimize(
          DrawFirstArrival(pieces[i].polygon, pieces[i].normal, pieces[i].area, lambda, random));
    }
  }
  CountItems(state, kBatch);
}

void BM_DrawParts(benchmark::State& state, const std::string& target, double lambda, double leg) {
  Force(target);
  const std::vector<Piece> pieces = RandomPieces(leg);
  DrawLanes lanes(kBatch);
  for (std::size_t i = 0; i < kBatch; ++i) {
    for (std::size_t k = 0; k < 12; ++k) {
      const int corner = std::min(static_cast<int>(k / 3), 2);
      lanes.corner[k][i] = pieces[i].polygon[corner][static_cast<int>(k % 3)];
    }
    lanes.area[i] = pieces[i].area;
    lanes.quad[i] = 0;
    lanes.counter[i] = StreamCounter(i, {1, 2, 3});
    lanes.part[i] = 0;
  }
  for (auto _ : state) {
    DrawParts(lanes, kBatch, lambda, kSeed);
    benchmark::ClobberMemory();
  }
  double settled = 0;
  for (std::size_t i = 0; i < kBatch; ++i) settled += static_cast<double>(lanes.settled[i]);
  CountItems(state, kBatch);
  state.counters["settled"] = settled / kBatch;
}

/// 10^6 points, one at a random place of each cell of a sheet: about what the scan hands on.
void BM_RejectClosePoints(benchmark::State& state, double distance) {
  constexpr std::int32_t kSide = 1000;
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  std::mt19937_64 random(kSeed);
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;
  for (std::int32_t x = 0; x < kSide; ++x) {
    for (std::int32_t y = 0; y < kSide; ++y) {
      const Vec3 in_cell = UniformVec(random);
      position.push_back(Vec3{static_cast<double>(x), static_cast<double>(y), 0} +
                         Vec3{in_cell.x, in_cell.y, 0});
      time.push_back(in_cell.z);
      cell.push_back({x, y, 0});
    }
  }
  const RunContext context;
  std::size_t survivors = 0;
  for (auto _ : state) {
    const auto survives = RejectClosePoints({position, time, cell}, distance, context);
    survivors = static_cast<std::size_t>(std::ranges::count(*survives, 1));
  }
  CountItems(state, position.size());
  state.counters["survive"] = static_cast<double>(survivors) / static_cast<double>(position.size());
}

std::string Number(double value) {
  std::string text = std::to_string(value);
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return text;
}

void RegisterForTarget(const std::string& target) {
  for (const double size : {0.05, 0.3, 1.0}) {
    benchmark::RegisterBenchmark(
        ("ClassifyTriangles/" + target + "/size:" + Number(size)).c_str(),
        [=](benchmark::State& state) { BM_ClassifyTriangles(state, target, size); });
  }
  for (const double size : {0.3, 1.0}) {
    benchmark::RegisterBenchmark(
        ("SplitTriangles/" + target + "/size:" + Number(size)).c_str(),
        [=](benchmark::State& state) { BM_SplitTriangles(state, target, size); });
  }
  for (const double leg : {0.05, 0.4}) {
    benchmark::RegisterBenchmark(
        ("DrawParts/" + target + "/lambda:5/leg:" + Number(leg)).c_str(),
        [=](benchmark::State& state) { BM_DrawParts(state, target, 5, leg); });
  }
}

void RegisterScalar() {
  for (const double lambda : {0.0, 5.0, 60.0}) {
    for (const double leg : {0.02, 0.2, 1.0}) {
      benchmark::RegisterBenchmark(
          ("DrawFirstArrival/lambda:" + Number(lambda) + "/leg:" + Number(leg)).c_str(),
          [=](benchmark::State& state) { BM_DrawFirstArrival(state, lambda, leg); });
    }
  }
  for (const double distance : {0.5, 0.75}) {
    benchmark::RegisterBenchmark(
        ("RejectClosePoints/points:1000000/distance:" + Number(distance)).c_str(),
        [=](benchmark::State& state) { BM_RejectClosePoints(state, distance); })
        ->Unit(benchmark::kMillisecond);
  }
}

}  // namespace
}  // namespace strata

int main(int argc, char** argv) {
  for (const std::string& target : strata::SimdTargets()) strata::RegisterForTarget(target);
  strata::RegisterScalar();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
}
