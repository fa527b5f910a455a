// The vector kernel's own promises: same answers on every instruction set, and a bound that never
// discards what could win (promise 3 rests on both).
#include "core/scan_kernel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "core/cell_race.h"
#include "core/numeric.h"
#include "core/race.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

constexpr std::size_t kBatch = 256;

// Forces each instruction set in turn, and the best one again at the end.
class EveryTarget : public testing::Test {
 protected:
  void TearDown() override { ASSERT_TRUE(ForceSimdTarget("auto")); }
};

Triangles RandomTriangles(std::size_t n, double least, double most, double reach,
                          TestRandom& random) {
  Triangles mesh;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3 at = random.InBox({-reach, -reach, -reach}, {reach, reach, reach});
    const double size = random.LogIn(least, most);
    const bool sliver = random.Unit() < 0.2;
    Triangle t;
    for (Vec3& c : t) c = at + random.Direction() * (size * random.Unit());
    if (sliver) t[2] = t[0] + (t[1] - t[0]) * random.Unit() + random.Direction() * (1e-6 * size);
    mesh.push_back(t);
  }
  return mesh;
}

TriangleBatch BatchOf(const Triangles& mesh) {
  TriangleBatch batch(mesh.size());
  for (std::size_t i = 0; i < mesh.size(); ++i) batch.Push(mesh[i][0], mesh[i][1], mesh[i][2], i);
  return batch;
}

// What the scalar path draws for part `p` when nothing stands against it.
Arrival DrawPart(SplitParts& parts, std::size_t p, Vec3 normal, const ScanParameters& parameters) {
  const Cell cell = parts.cells.cell(p);
  const Vec3 center{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5};
  Polygon world, local;
  for (int v = 0; v < 3; ++v) world.Push(parts.geometry.Corner(p, v));
  const Vec3 fourth{parts.fourth[0][p], parts.fourth[1][p], parts.fourth[2][p]};
  double area = 0.5 * Norm(Cross(world[1] - world[0], world[2] - world[0]));
  if (fourth != world[2]) {
    area += 0.5 * Norm(Cross(world[2] - world[0], fourth - world[0]));
    world.Push(fourth);
  }
  for (int i = 0; i < world.size; ++i) local.Push(world[i] - center);
  const RandomStream random(parameters.seed, parts.geometry.hash[p], cell,
                            static_cast<std::uint32_t>(parts.geometry.part[p]));
  return *DrawFirstArrival(local, normal, area, parameters.lambda, random);
}

struct BoundTally {
  std::uint64_t parts = 0, early = 0;
  double worst = HUGE_VAL;  // Smallest ratio of an arrival's time to its bound.
  void Add(double time, double bound) {
    ++parts;
    if (time < bound) ++early;
    if (bound > 0) worst = std::min(worst, time / bound);
  }
};

class Kernel {
 public:
  Kernel(const Triangles& mesh, const ScanParameters& parameters)
      : batch_(BatchOf(mesh)),
        parameters_(parameters),
        lanes_(mesh.size()),
        scratch_{SplitQueue(kMediumParts / 3 * mesh.size()),
                 SplitQueue(kMediumParts / 3 * mesh.size())},
        parts_(kSmallParts * mesh.size()),
        medium_parts_(kMediumParts * mesh.size()) {
    ClassifyTriangles(batch_, parameters_, lanes_);
    SplitTriangles(lanes_.small, 0, lanes_.small.size, parameters_, scratch_[0], scratch_[1],
                   parts_);
    SplitTriangles(lanes_.medium, 0, lanes_.medium.size, parameters_, scratch_[0], scratch_[1],
                   medium_parts_);
  }
  TriangleLanes& lanes() { return lanes_; }
  SplitParts& parts() { return parts_; }
  SplitParts& medium_parts() { return medium_parts_; }

  // The unit normal of a triangle of the batch, from its corners in canonical rotation.
  Vec3 Normal(std::size_t i) const {
    const Vec3 n =
        CanonicalAreaVector(batch_.corner(i, 0), batch_.corner(i, 1), batch_.corner(i, 2));
    return n * (1 / Norm(n));
  }
  void CheckParts(BoundTally& tally) {
    for (SplitParts* parts : {&parts_, &medium_parts_}) {
      for (std::size_t p = 0; p < parts->geometry.size; ++p) {
        const Arrival arrival = DrawPart(*parts, p, Normal(parts->geometry.root[p]), parameters_);
        tally.Add(arrival.time, parts->cells.time_bound[p]);
      }
    }
  }
  void CheckInside(BoundTally& tally) {
    for (std::size_t i = 0; i < batch_.size(); ++i) {
      if (static_cast<TriangleKind>(lanes_.kind[i]) != TriangleKind::kInside) continue;
      const Vec3 n =
          CanonicalAreaVector(batch_.corner(i, 0), batch_.corner(i, 1), batch_.corner(i, 2));
      const std::uint64_t h[3] = {HashVertex(batch_.corner(i, 0)), HashVertex(batch_.corner(i, 1)),
                                  HashVertex(batch_.corner(i, 2))};
      const int first = CanonicalFirst(h[0], h[1], h[2]);
      const Cell cell = lanes_.cells.cell(i);
      Polygon local;
      const double per_edge = 1 / parameters_.lattice.edge;
      for (int k = 0; k < 3; ++k) {
        const Vec3 c = (batch_.corner(i, (first + k) % 3) - parameters_.lattice.origin) * per_edge;
        local.Push(c - Vec3{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5});
      }
      const double area = 0.5 * Norm(n) * (per_edge * per_edge);
      const RandomStream random(parameters_.seed, HashTriangle(h[0], h[1], h[2]), cell, 0);
      const auto arrival =
          DrawFirstArrival(local, n * (1 / Norm(n)), area, parameters_.lambda, random);
      tally.Add(arrival->time, lanes_.cells.time_bound[i]);
    }
  }

 private:
  TriangleBatch batch_;
  ScanParameters parameters_;
  TriangleLanes lanes_;
  SplitQueue scratch_[2];
  SplitParts parts_, medium_parts_;
};

TEST_F(EveryTarget, TimeBoundIsNeverLaterThanTheArrival) {
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    for (const double lambda : {0.0, 0.3, 0.5, 1.0, 2.0, 5.0, 20.0, 60.0, 500.0}) {
      for (const double reach : {3.0, 1e4, 0x1p28}) {
        TestRandom random(21);
        BoundTally inside, split;
        for (int round = 0; round < 12; ++round) {
          ScanParameters parameters;
          parameters.lambda = lambda;
          parameters.seed = static_cast<std::uint64_t>(round);
          Kernel kernel(RandomTriangles(kBatch, 1e-3, 2, reach, random), parameters);
          kernel.CheckInside(inside);
          kernel.CheckParts(split);
        }
        EXPECT_EQ(inside.early, 0u) << target << ", lambda " << lambda << ", reach " << reach
                                    << ": of " << inside.parts << "; worst " << inside.worst;
        EXPECT_EQ(split.early, 0u) << target << ", lambda " << lambda << ", reach " << reach
                                   << ": of " << split.parts << "; worst " << split.worst;
        EXPECT_GT(inside.parts, 1000u);
        EXPECT_GT(split.parts, 1000u);
      }
    }
  }
}

// Needles on rays from the middles of cells, many thinner than the rounding of coordinates counted
// from a far origin: which side of an edge the middle is on is then anybody's guess.
Triangles RayNeedles(std::size_t n, TestRandom& random) {
  Triangles mesh;
  while (mesh.size() < n) {
    const Vec3 cell = random.InBox({-5, -5, -5}, {5, 5, 5});
    const Vec3 center{std::floor(cell.x) + 0.5, std::floor(cell.y) + 0.5, std::floor(cell.z) + 0.5};
    Vec3 along = random.Direction() * 0.5;
    if (random.Unit() < 0.7) along[static_cast<int>(random.Below(3))] = 0;
    const double from = random.In(0, 0.8), to = random.In(from, random.Unit() < 0.2 ? 6 : 1);
    const Vec3 aside = random.Direction() * random.LogIn(1e-15, 1e-4);
    mesh.push_back(
        {center + along * from, center + along * to, center + along * random.In(from, to) + aside});
  }
  return mesh;
}

TEST_F(EveryTarget, TimeBoundIsNeverLaterThanTheArrivalOnNeedlesThroughTheMiddle) {
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    for (const double lambda : {5.0, 20.0, 60.0, 500.0}) {
      for (const double shift : {0.0, 1e3, 1e6, 1e9}) {
        TestRandom random(27);
        BoundTally inside, split;
        for (int round = 0; round < 40; ++round) {
          ScanParameters parameters;
          parameters.lambda = lambda;
          parameters.seed = static_cast<std::uint64_t>(round);
          parameters.lattice.origin = {-shift, shift, shift};
          Kernel kernel(RayNeedles(kBatch, random), parameters);
          kernel.CheckInside(inside);
          kernel.CheckParts(split);
        }
        EXPECT_EQ(inside.early, 0u) << target << ", lambda " << lambda << ", shift " << shift
                                    << ": of " << inside.parts << "; worst " << inside.worst;
        EXPECT_EQ(split.early, 0u) << target << ", lambda " << lambda << ", shift " << shift
                                   << ": of " << split.parts << "; worst " << split.worst;
        EXPECT_GT(inside.parts, 1000u);
      }
    }
  }
}

template <class T>
void ExpectSameColumn(LaneArray<T>& a, LaneArray<T>& b, std::size_t n, const char* name) {
  for (std::size_t i = 0; i < n; ++i) ASSERT_EQ(a[i], b[i]) << name << " of " << i;
}

void ExpectSameCells(CellParts& a, CellParts& b, std::size_t n) {
  ExpectSameColumn(a.area, b.area, n, "area");
  ExpectSameColumn(a.time_bound, b.time_bound, n, "time bound");
  ExpectSameColumn(a.x, b.x, n, "x");
  ExpectSameColumn(a.y, b.y, n, "y");
  ExpectSameColumn(a.z, b.z, n, "z");
  ExpectSameColumn(a.cell_hash, b.cell_hash, n, "cell hash");
}

// A part's name in any order of parts.
using PartKey = std::array<std::uint64_t, 3>;
std::map<PartKey, std::array<double, 13>> PartsByName(SplitParts& parts) {
  std::map<PartKey, std::array<double, 13>> all;
  for (std::size_t p = 0; p < parts.geometry.size; ++p) {
    std::array<double, 13> values{};
    for (std::size_t k = 0; k < 9; ++k) values[k] = parts.geometry.corner[k][p];
    for (std::size_t k = 0; k < 3; ++k) values[9 + k] = parts.fourth[k][p];
    values[12] = static_cast<double>(parts.cells.area[p]);
    const bool fresh =
        all.emplace(PartKey{parts.geometry.hash[p], parts.geometry.root[p], parts.geometry.part[p]},
                    values)
            .second;
    EXPECT_TRUE(fresh) << "two parts of a triangle share a name";
  }
  return all;
}

TEST_F(EveryTarget, GivesTheSameAnswers) {
  TestRandom random(22);
  const Triangles mesh = RandomTriangles(1000, 1e-3, 4, 3, random);
  ScanParameters parameters;
  parameters.lattice = {{-0.1, 0.2, 0.3}, 0.7};
  parameters.probes = {HashVertex(mesh[7][1]), HashVertex({1, 2, 3})};
  const std::vector<std::string> targets = SimdTargets();
  ASSERT_TRUE(ForceSimdTarget(targets.back()));
  Kernel plainest(mesh, parameters);
  for (const std::string& target : targets) {
    SCOPED_TRACE(target);
    ASSERT_TRUE(ForceSimdTarget(target));
    Kernel kernel(mesh, parameters);
    ExpectSameCells(plainest.lanes().cells, kernel.lanes().cells, mesh.size());
    ExpectSameColumn(plainest.lanes().kind, kernel.lanes().kind, mesh.size(), "kind");
    ExpectSameColumn(plainest.lanes().world_area, kernel.lanes().world_area, mesh.size(), "area");
    const BatchTotals &a = plainest.lanes().totals, &b = kernel.lanes().totals;
    EXPECT_EQ(a.surface, b.surface);
    EXPECT_EQ(a.bounds, b.bounds);
    EXPECT_EQ(a.area, b.area);
    EXPECT_EQ(a.usable, b.usable);
    EXPECT_EQ(a.probes_found, 1u);
    EXPECT_EQ(b.probes_found, 1u);
    EXPECT_EQ(PartsByName(plainest.parts()), PartsByName(kernel.parts()));
    EXPECT_EQ(PartsByName(plainest.medium_parts()), PartsByName(kernel.medium_parts()));
  }
}

TEST_F(EveryTarget, PartsOfATriangleLieInTheirCellsAndAddUpToIt) {
  TestRandom random(25);
  const Triangles mesh = RandomTriangles(2000, 0.1, 4, 8, random);
  for (const std::string& target : SimdTargets()) {
    SCOPED_TRACE(target);
    ASSERT_TRUE(ForceSimdTarget(target));
    Kernel kernel(mesh, {});
    EXPECT_GT(kernel.lanes().small.size, 100u);
    EXPECT_GT(kernel.lanes().medium.size, 100u);
    std::vector<double> area(mesh.size());
    for (SplitParts* parts : {&kernel.parts(), &kernel.medium_parts()}) {
      for (std::size_t p = 0; p < parts->geometry.size; ++p) {
        area[parts->geometry.root[p]] += parts->area[p];
        const Cell cell = parts->cells.cell(p);
        const Vec3 low{1.0 * cell.x, 1.0 * cell.y, 1.0 * cell.z};
        const Vec3 fourth{parts->fourth[0][p], parts->fourth[1][p], parts->fourth[2][p]};
        for (const Vec3& corner : {parts->geometry.Corner(p, 0), parts->geometry.Corner(p, 1),
                                   parts->geometry.Corner(p, 2), fourth}) {
          for (int k = 0; k < 3; ++k) {
            EXPECT_GE(corner[k], low[k]) << "part " << p;
            EXPECT_LE(corner[k], low[k] + 1) << "part " << p;
          }
        }
      }
    }
    for (SplitQueue* split : {&kernel.lanes().small, &kernel.lanes().medium}) {
      for (std::size_t i = 0; i < split->size; ++i) {
        const std::size_t root = split->root[i];
        EXPECT_NEAR(area[root], kernel.lanes().world_area[root], 1e-12) << "triangle " << root;
      }
    }
  }
}

TEST_F(EveryTarget, BoundsPartsCutElsewhereAsItsOwn) {
  TestRandom random(26);
  const Triangles mesh = RandomTriangles(500, 1e-3, 3, 5, random);
  for (const std::string& target : SimdTargets()) {
    SCOPED_TRACE(target);
    ASSERT_TRUE(ForceSimdTarget(target));
    Kernel own(mesh, {}), other(mesh, {});
    SplitParts& parts = other.medium_parts();
    const std::size_t n = parts.geometry.size;
    ASSERT_GT(n, 100u);
    for (std::size_t p = 0; p < n; ++p) {
      parts.cells.time_bound[p] = -7;
      parts.cells.area[p] = 7;
      parts.cells.cell_hash[p] = 7;
      parts.area[p] = 7;
    }
    BoundParts(parts, {});
    ExpectSameCells(own.medium_parts().cells, parts.cells, n);
    ExpectSameColumn(own.medium_parts().area, parts.area, n, "area");
    // What is thinner than the rounding of its corners is dropped.
    parts.geometry.SetCorner(3, 1, parts.geometry.Corner(3, 0));
    parts.geometry.SetCorner(3, 2, parts.geometry.Corner(3, 0));
    for (int k = 0; k < 3; ++k) {
      parts.fourth[static_cast<std::size_t>(k)][3] = parts.geometry.Corner(3, 0)[k];
    }
    BoundParts(parts, {});
    EXPECT_EQ(parts.cells.time_bound[3], kDroppedPart);
  }
}

TEST_F(EveryTarget, HashesAsTheScalarCodeDoes) {
  TestRandom random(23);
  Triangles mesh = RandomTriangles(500, 1e-3, 4, 3, random);
  mesh.push_back({Vec3{-0.0, 0, 0}, Vec3{1, -0.0, 0}, Vec3{0, 1, -0.0}});
  ScanParameters parameters;
  SurfaceHash expected;
  for (const Triangle& t : mesh) {
    expected.Add(HashTriangle(HashVertex(t[0]), HashVertex(t[1]), HashVertex(t[2])));
  }
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    EXPECT_EQ(Kernel(mesh, parameters).lanes().totals.surface, expected) << target;
  }
}

// A triangle or a convex quadrilateral in a cell, relative to its centre.
struct CellPiece {
  Polygon polygon;
  Vec3 normal;
  double area;
};
CellPiece RandomCellPiece(TestRandom& random) {
  const double size = random.LogIn(1e-4, 0.7);
  const Vec3 u = random.Direction() * size, v = random.Direction() * (size * random.LogIn(1e-3, 1));
  const Vec3 at = random.InBox({-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5});
  CellPiece piece;
  piece.polygon.Push(at);
  piece.polygon.Push(at + u);
  if (random.Unit() < 0.5) {
    piece.polygon.Push(at + u + v * random.Unit());
    piece.polygon.Push(at + v);
  } else {
    piece.polygon.Push(at + v);
  }
  for (int i = 0; i < piece.polygon.size; ++i) {
    for (int a = 0; a < 3; ++a) piece.polygon[i][a] = std::clamp(piece.polygon[i][a], -0.5, 0.5);
  }
  const Polygon& p = piece.polygon;
  const Vec3 n = Cross(p[1] - p[0], p[2] - p[0]);
  piece.normal = n * (1 / Norm(n));
  piece.area = 0.5 * Norm(n);
  if (p.size == 4) piece.area += 0.5 * Norm(Cross(p[2] - p[0], p[3] - p[0]));
  return piece;
}

void FillLane(const CellPiece& piece, std::size_t i, std::uint64_t counter, std::uint64_t part,
              DrawLanes& lanes) {
  for (int v = 0; v < piece.polygon.size; ++v) {
    for (int a = 0; a < 3; ++a) {
      lanes.corner[static_cast<std::size_t>(3 * v + a)][i] = piece.polygon[v][a];
    }
  }
  lanes.quad[i] = piece.polygon.size == 4 ? 1 : 0;
  lanes.area[i] = piece.area;
  lanes.counter[i] = counter;
  lanes.part[i] = part;
}

TEST_F(EveryTarget, DrawsAsTheScalarCodeDoes) {
  constexpr std::size_t kPieces = 3001;
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    for (const double lambda : {0.01, 1.0, 5.0, 60.0, 500.0}) {
      SCOPED_TRACE(target + ", lambda " + std::to_string(lambda));
      TestRandom random(24);
      constexpr std::uint64_t kSeed = 0xfedcba9876543210;
      std::vector<CellPiece> pieces;
      std::vector<std::uint64_t> counters, parts;
      DrawLanes lanes(kPieces);
      for (std::size_t i = 0; i < kPieces; ++i) {
        pieces.push_back(RandomCellPiece(random));
        counters.push_back(random.Bits());
        parts.push_back(random.Below(64));
        FillLane(pieces[i], i, counters[i], parts[i], lanes);
      }
      DrawParts(lanes, kPieces, lambda, kSeed);
      std::size_t settled = 0;
      for (std::size_t i = 0; i < kPieces; ++i) {
        if (lanes.settled[i] == 0) continue;
        ++settled;
        const RandomStream stream(kSeed, counters[i], Cell{}, static_cast<std::uint32_t>(parts[i]));
        const auto scalar =
            DrawFirstArrival(pieces[i].polygon, pieces[i].normal, pieces[i].area, lambda, stream);
        ASSERT_TRUE(scalar);
        ASSERT_EQ(lanes.time[i], scalar->time) << "piece " << i;
        const Vec3 local{lanes.local[0][i], lanes.local[1][i], lanes.local[2][i]};
        ASSERT_EQ(local, scalar->local) << "piece " << i;
      }
      EXPECT_GT(settled, lambda < 100 ? kPieces / 3 : 0);
    }
  }
}

TEST_F(EveryTarget, RefusesAnUnknownNameAndListsTheKnownOnes) {
  const auto refused = ForceSimdTarget("abacus");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
  for (const std::string& target : SimdTargets()) {
    EXPECT_NE(refused.error().message.find(target), std::string::npos) << target;
  }
}

}  // namespace
}  // namespace strata::test
