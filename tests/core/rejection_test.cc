// Promise 4: the minimum distance is the paper's rule.
#include "core/rejection.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <cmath>
#include <cstdio>
#include <functional>
#include <string>

#include "core/sample_mesh.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/rejection_oracle.h"

namespace strata::test {
namespace {

// Points with what rejection needs to know of them.
struct PointSet {
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;

  RejectionInput input() const { return {position, time, cell}; }
};

// Times are drawn from a few values, so that the cells decide as well.
PointSet WithKeys(std::vector<Vec3> position, TestRandom& random) {
  PointSet set;
  set.position = std::move(position);
  const bool few_times = random.Unit() < 0.5;
  for (std::size_t i = 0; i < set.position.size(); ++i) {
    set.time.push_back(few_times ? static_cast<double>(random.Below(3)) : random.Unit());
    const auto at = [&](int shift) { return static_cast<std::int32_t>(i >> shift) % 7 - 3; };
    set.cell.push_back({at(0), at(2), at(4)});
  }
  return set;
}

// Each makes about n points whose typical spacing is 1.
using MakePoints = std::function<std::vector<Vec3>(std::size_t n, TestRandom& random)>;
struct Family {
  const char* name;
  MakePoints make;
};

std::vector<Vec3> Repeat(std::size_t n, const std::function<Vec3()>& point) {
  std::vector<Vec3> points;
  for (std::size_t i = 0; i < n; ++i) points.push_back(point());
  return points;
}

std::vector<Vec3> SomeOf(std::vector<Vec3> points, std::size_t n, TestRandom& random) {
  random.Shuffle(points);
  points.resize(std::min(n, points.size()));
  return points;
}

// Points of a lattice: exact ties everywhere.
std::vector<Vec3> LatticePoints(std::size_t n, int dimensions, Vec3 scale) {
  std::vector<Vec3> points;
  const int side = static_cast<int>(std::ceil(std::pow(n, 1.0 / dimensions)));
  for (int x = 0; x < side; ++x) {
    for (int y = 0; y < (dimensions > 1 ? side : 1); ++y) {
      for (int z = 0; z < (dimensions > 2 ? side : 1); ++z) {
        points.push_back({x * scale.x, y * scale.y, z * scale.z});
      }
    }
  }
  return points;
}

const std::vector<Family>& Families() {
  static const std::vector<Family> families = {
      {"volume",
       [](std::size_t n, TestRandom& r) {
         const double s = std::cbrt(n);
         return Repeat(n, [&] { return r.InBox({0, 0, 0}, {s, s, s}); });
       }},
      {"plane",
       [](std::size_t n, TestRandom& r) {
         const double s = std::sqrt(n);
         return Repeat(n, [&] { return Vec3{r.In(0, s), r.In(0, s), 0.25}; });
       }},
      {"oblique plane, far away",
       [](std::size_t n, TestRandom& r) {
         const double s = std::sqrt(n);
         return Repeat(n, [&] {
           const double u = r.In(0, s), v = r.In(0, s);
           return Vec3{1e6 + u, -1e6 + v, 0.5 * u - 0.25 * v};
         });
       }},
      {"clusters",
       [](std::size_t n, TestRandom& r) {
         const auto centres = Repeat(1 + n / 12, [&] { return r.InBox({0, 0, 0}, {4, 4, 4}); });
         return Repeat(n, [&] {
           return centres[r.Below(centres.size())] + r.Direction() * (0.5 * r.Unit());
         });
       }},
      {"coincident points",
       [](std::size_t n, TestRandom& r) {
         const auto places = Repeat(1 + n / 4, [&] { return r.InBox({0, 0, 0}, {3, 3, 3}); });
         return Repeat(n, [&] { return places[r.Below(places.size())]; });
       }},
      {"line",
       [](std::size_t n, TestRandom& r) {
         const Vec3 d = r.Direction();
         return Repeat(n, [&] { return d * r.In(0, static_cast<double>(n)); });
       }},
      {"even line",
       [](std::size_t n, TestRandom&) {
         return LatticePoints(n, 1, {0.75, 0, 0});
       }},
      {"square lattice",
       [](std::size_t n, TestRandom& r) {
         return SomeOf(LatticePoints(n + n / 4, 2, {0.75, 0.75, 1}), n, r);
       }},
      {"cubic lattice",
       [](std::size_t n, TestRandom& r) {
         return SomeOf(LatticePoints(n + n / 4, 3, {1, 1, 1}), n, r);
       }},
      {"lattice with rounded spacing",
       [](std::size_t n, TestRandom& r) {
         return SomeOf(LatticePoints(n, 2, {0.7, 0.3, 1}), n, r);
       }},
      {"one place",
       [](std::size_t n, TestRandom&) {
         return std::vector<Vec3>(n, Vec3{1.5, -2.5, 3.5});
       }},
  };
  return families;
}

std::vector<std::uint8_t> Reject(const PointSet& set, double distance) {
  const RunContext context;
  auto survives = RejectClosePoints(set.input(), distance, context);
  if (!survives) {
    ADD_FAILURE() << survives.error().message;
    return {};
  }
  return *survives;
}

void ExpectNothingCloser(const PointSet& set, const std::vector<std::uint8_t>& survives,
                         double distance) {
  for (std::size_t i = 0; i < survives.size(); ++i) {
    for (std::size_t j = 0; j < i && survives[i]; ++j) {
      if (!survives[j]) continue;
      ASSERT_GE(Norm2(set.position[i] - set.position[j]), distance * distance);
    }
  }
}

TEST(Promise4MinimumDistance, EqualsTheOracleOnEveryFamilyOfPoints) {
  int sets = 0;
  for (const Family& family : Families()) {
    TestRandom random(51);
    for (int round = 0; round < 40; ++round) {
      const std::size_t n =
          round < 8 ? 2 + random.Below(6) : 2 + random.Below(random.Below(4) ? 80 : 299);
      const PointSet set = WithKeys(family.make(n, random), random);
      const double choices[] = {0.1, 0.25, 0.5, 0.75, 1, 1.5};
      const double distance = round % 2 ? choices[random.Below(6)] : random.In(0.1, 1.5);
      const auto survives = Reject(set, distance);
      const auto expected = RejectOneAtATime(set.input(), distance);
      ASSERT_EQ(survives, expected) << family.name << ", seed 51, round " << round << ", "
                                    << set.position.size() << " points, distance " << distance;
      ExpectNothingCloser(set, survives, distance);
      ++sets;
    }
  }
  std::printf("%d sets of points, seed 51\n", sets);
}

TEST(Promise4MinimumDistance, DoesNotDependOnThreads) {
  TestRandom random(52);
  const PointSet set = WithKeys(Families()[1].make(20000, random), random);
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, 8);
  std::vector<std::uint8_t> first;
  for (const int threads : {1, 2, 3, 8}) {
    tbb::task_arena arena(threads);
    const auto survives = arena.execute([&] { return Reject(set, 0.8); });
    if (first.empty()) first = survives;
    EXPECT_EQ(survives, first) << threads << " threads";
  }
}

TEST(Promise4MinimumDistance, TheLaterOfTwoTiedGoes) {
  PointSet pair{{{0, 0, 0}, {0.3, 0, 0}}, {2, 1}, {{0, 0, 0}, {1, 0, 0}}};
  EXPECT_EQ(Reject(pair, 0.5), (std::vector<std::uint8_t>{0, 1}));
  pair.time = {1, 2};
  EXPECT_EQ(Reject(pair, 0.5), (std::vector<std::uint8_t>{1, 0}));
}

TEST(Promise4MinimumDistance, TheLargerCellOfTwoTiedAtOneTimeGoes) {
  PointSet pair{{{0, 0, 0}, {0.3, 0, 0}}, {1, 1}, {{0, 5, 0}, {0, 4, 9}}};
  EXPECT_EQ(Reject(pair, 0.5), (std::vector<std::uint8_t>{0, 1}));
  pair.cell = {{0, 4, 9}, {0, 5, 0}};
  EXPECT_EQ(Reject(pair, 0.5), (std::vector<std::uint8_t>{1, 0}));
}

TEST(Promise4MinimumDistance, PointsExactlyThatFarApartStay) {
  const PointSet pair{{{0, 0, 0}, {0.5, 0, 0}}, {1, 2}, {{0, 0, 0}, {1, 0, 0}}};
  EXPECT_EQ(Reject(pair, 0.5), (std::vector<std::uint8_t>{1, 1}));
  EXPECT_EQ(Reject(pair, std::nextafter(0.5, 1)), (std::vector<std::uint8_t>{1, 0}));
}

TEST(Promise4MinimumDistance, ZeroKeepsEverything) {
  const PointSet same{{{1, 1, 1}, {1, 1, 1}}, {1, 2}, {{0, 0, 0}, {1, 0, 0}}};
  EXPECT_EQ(Reject(same, 0), (std::vector<std::uint8_t>{1, 1}));
}

TEST(Promise4MinimumDistance, NoPointsAndOnePointAreLeftAlone) {
  EXPECT_TRUE(Reject({}, 1).empty());
  EXPECT_EQ(Reject({{{1, 2, 3}}, {1}, {{0, 0, 0}}}, 1), (std::vector<std::uint8_t>{1}));
}

// Distances from far below the spacing to far above the extent, where hash cells are tiny or huge.
TEST(Promise4MinimumDistance, EqualsTheOracleAtExtremeDistances) {
  TestRandom random(53);
  for (const double distance : {1e-300, 1e-160, 1e-30, 1e-15, 1e-9, 1e3, 1e9, 1e150}) {
    PointSet set = WithKeys(Families()[0].make(60, random), random);
    set.position.push_back(set.position[0]);
    set.position.push_back(set.position[1] + Vec3{0.5 * distance, 0, 0});
    set.time.resize(set.position.size(), 0.5);
    set.cell.resize(set.position.size(), Cell{9, 9, 9});
    EXPECT_EQ(Reject(set, distance), RejectOneAtATime(set.input(), distance)) << distance;
  }
}

TEST(Promise4MinimumDistance, EqualsTheOracleAtExtremeScales) {
  TestRandom random(54);
  for (const double scale : {1e-100, 1e-30, 1e-9, 1e9, 1e30, 1e100}) {
    PointSet set = WithKeys(Families()[0].make(80, random), random);
    for (Vec3& p : set.position) p = p * scale;
    EXPECT_EQ(Reject(set, 0.7 * scale), RejectOneAtATime(set.input(), 0.7 * scale)) << scale;
  }
}

TEST(Promise4MinimumDistance, HoldsFarFromTheOrigin) {
  TestRandom random(57);
  PointSet near = WithKeys(Families()[1].make(200, random), random), far = near;
  // A power of two that leaves the low bits of the coordinates alone keeps distances exact.
  for (std::size_t i = 0; i < near.position.size(); ++i) {
    for (int a = 0; a < 3; ++a) {
      near.position[i][a] = std::floor(near.position[i][a] * 0x1p20) * 0x1p-20;
      far.position[i][a] = near.position[i][a] + 0x1p30;
    }
  }
  EXPECT_EQ(Reject(near, 0.75), Reject(far, 0.75));
}

TEST(Promise4MinimumDistance, ACancelledRunSaysSo) {
  TestRandom random(55);
  const PointSet set = WithKeys(Families()[0].make(100, random), random);
  RunContext context;
  context.Cancel();
  const auto survives = RejectClosePoints(set.input(), 0.5, context);
  ASSERT_FALSE(survives);
  EXPECT_EQ(survives.error().code, ErrorCode::kCancelled);
}

// Through the whole job, where the samples of a mesh are what is thinned.
TEST(Promise4MinimumDistance, SamplesOfAMeshAreThinnedAsTheOracleDoes) {
  TestRandom random(56);
  Triangles mesh;
  for (int i = 0; i < 60; ++i) {
    const Vec3 at = random.InBox({-2, -2, -2}, {2, 2, 2});
    Triangle t;
    for (Vec3& c : t) c = at + random.Direction() * random.In(0.1, 2);
    mesh.push_back(t);
  }
  for (const double m : {0.1, 0.5, 0.75, 1.0, 1.5}) {
    SampleOptions options;
    options.lattice = VoxelSize{1};
    options.attributes = kCell;
    options.min_distance = 0;
    RunContext context;
    MemoryMesh before(mesh), after(mesh);
    const auto all = SampleMesh(before, options, context);
    options.min_distance = m;
    const auto kept = SampleMesh(after, options, context);
    ASSERT_TRUE(all && kept);
    // Samples are in order; survivors keep it. Nothing else of them changes.
    std::size_t next = 0;
    for (std::size_t i = 0; i < all->samples.size() && next < kept->samples.size(); ++i) {
      if (all->samples.cell[i] != kept->samples.cell[next]) continue;
      EXPECT_EQ(all->samples.position[i], kept->samples.position[next]);
      ++next;
    }
    EXPECT_EQ(next, kept->samples.size());
    EXPECT_EQ(kept->stats.cells, all->samples.size());
    EXPECT_EQ(kept->stats.survivors, kept->samples.size());
    EXPECT_LT(kept->samples.size(), all->samples.size());
    PointSet left{kept->samples.position, {}, {}};
    ExpectNothingCloser(left, std::vector<std::uint8_t>(left.position.size(), 1), m);
  }
}

}  // namespace
}  // namespace strata::test
