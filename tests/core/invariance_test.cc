// Promise 3: the samples are a function of the surface, the options and the seed.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <sstream>
#include <string>

#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/samples_equal.h"
#include "tests/support/scans.h"

namespace strata::test {
namespace {

using Vertices = MemoryMesh::Vertices;

// Float coordinates, so that every carrier holds the same numbers.
Vec3 AsFloat(Vec3 p) {
  return {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
}

// Triangles within cells, across a few and across many, over a lattice of edge about 1.
Triangles MixedMesh() {
  TestRandom random(41);
  Triangles mesh;
  for (int i = 0; i < 6000; ++i) {
    const double size = i % 100 == 0 ? random.In(5, 40) : random.LogIn(0.01, 3);
    const Vec3 at = random.InBox({-20, -20, -20}, {20, 20, 20});
    Triangle t;
    for (Vec3& c : t) c = AsFloat(at + random.Direction() * (size * random.In(0.5, 1)));
    mesh.push_back(t);
  }
  return mesh;
}

// A sphere in float: thousands of vertices so close to their enclosing ball's sphere that rounding
// decides which of them carry it.
Triangles SphereMesh() {
  Triangles mesh;
  constexpr int kRings = 40, kSides = 60;
  const auto at = [](int ring, int side) {
    const double polar = M_PI * ring / kRings, turn = 2 * M_PI * (side % kSides) / kSides;
    return AsFloat(
        Vec3{std::sin(polar) * std::cos(turn), std::sin(polar) * std::sin(turn), std::cos(polar)} *
        1.7);
  };
  for (int r = 0; r < kRings; ++r) {
    for (int s = 0; s < kSides; ++s) {
      if (r > 0) mesh.push_back({at(r, s), at(r + 1, s), at(r, s + 1)});
      if (r + 1 < kRings) mesh.push_back({at(r + 1, s), at(r + 1, s + 1), at(r, s + 1)});
    }
  }
  return mesh;
}

Triangles ScanMesh(const std::filesystem::path& path) {
  const auto reader = OpenScan(path);
  return reader ? ReadTriangles(*reader) : Triangles();
}

std::string Text(Vec3 p) {
  std::ostringstream out;
  out << p.x << ' ' << p.y << ' ' << p.z;
  return out.str();
}

SampleResult Sample(MemoryMesh& reader, const SampleOptions& options) {
  RunContext context;
  auto result = SampleMesh(reader, options, context);
  if (!result) {
    ADD_FAILURE() << result.error().message;
    return {};
  }
  return std::move(*result);
}

double ExtentOf(const Triangles& mesh) {
  Bounds bounds;
  for (const Triangle& t : mesh) {
    for (const Vec3& c : t) bounds.Add(c);
  }
  return bounds.max.x - bounds.min.x;
}

struct NamedOptions {
  std::string name;
  SampleOptions options;
};

// Each lattice, each way of drawing.
std::vector<NamedOptions> OptionSets(double extent) {
  std::vector<NamedOptions> all;
  const auto add = [&](const char* name, LatticeSpec lattice, double lambda, double distance,
                       Integrator integrator) {
    SampleOptions o;
    o.lattice = lattice;
    o.lambda = lambda;
    o.min_distance = distance;
    o.integrator = integrator;
    o.attributes = kAllAttributes;
    o.seed = 0x123456789abcdef0;
    o.threads = 1;
    all.push_back({name, o});
  };
  add("resolution 60, lambda 5", Resolution{60}, 5, 0.5, Integrator::kExact);
  add("voxels, lambda 0", VoxelSize{extent / 43.21}, 0, 0, Integrator::kExact);
  add("height 6, lambda 20", Height{6}, 20, 0.75, Integrator::kExact);
  add("height 6, subdivided", Height{6}, 5, 0.5, Integrator::kSubdivide);
  return all;
}

class Invariance : public testing::Test {
 protected:
  void TearDown() override { ASSERT_TRUE(ForceSimdTarget("auto")); }

  static std::vector<std::pair<std::string, Triangles>> Meshes() {
    std::vector<std::pair<std::string, Triangles>> meshes = {{"mixed sizes", MixedMesh()},
                                                             {"float sphere", SphereMesh()}};
    if (const auto path = ScanPath("dragon_vrip_res3.ply.gz"); !path.empty()) {
      meshes.emplace_back("dragon scan", ScanMesh(path));
    } else {
      std::puts("dragon_vrip_res3.ply.gz is not there; the scan is left out");
    }
    return meshes;
  }

  // Calls `vary` with every mesh, options and the result to be had again.
  using Vary = std::function<void(const Triangles&, const SampleOptions&, const SampleResult&)>;
  static void ForEachCase(const Vary& vary) {
    for (const auto& [mesh_name, mesh] : Meshes()) {
      for (const NamedOptions& set : OptionSets(ExtentOf(mesh))) {
        SCOPED_TRACE(mesh_name + ", " + set.name);
        MemoryMesh reader(mesh);
        const SampleResult expected = Sample(reader, set.options);
        ASSERT_GT(expected.samples.size(), 100u);
        vary(mesh, set.options, expected);
      }
    }
  }
  static void ExpectSame(const SampleResult& expected, MemoryMesh reader,
                         const SampleOptions& options, const std::string& what) {
    const SampleResult result = Sample(reader, options);
    EXPECT_TRUE(SameSamples(expected.samples, result.samples)) << what;
    EXPECT_TRUE(SameStats(expected.stats, result.stats)) << what;
  }
};

Triangles Rotated(Triangles mesh, TestRandom& random) {
  for (Triangle& t : mesh)
    std::rotate(t.begin(), t.begin() + static_cast<long>(random.Below(3)), t.end());
  return mesh;
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnThreads) {
  ForEachCase([](const Triangles& mesh, SampleOptions options, const SampleResult& expected) {
    for (const int threads : {2, 3, 8}) {
      options.threads = threads;
      // Many small batches, so that the threads share the work in ever new ways.
      options.batch_size = 100;
      ExpectSame(expected, MemoryMesh(mesh), options, std::to_string(threads) + " threads");
    }
  });
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnBatches) {
  ForEachCase([](const Triangles& mesh, SampleOptions options, const SampleResult& expected) {
    for (const std::size_t size : {1, 7, 4096}) {
      options.batch_size = size;
      ExpectSame(expected, MemoryMesh(mesh), options, "batches of " + std::to_string(size));
    }
  });
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnTheOrderOfTriangles) {
  ForEachCase(
      [](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        TestRandom random(42);
        for (int round = 0; round < 3; ++round) {
          Triangles shuffled = mesh;
          random.Shuffle(shuffled);
          ExpectSame(expected, MemoryMesh(shuffled), options, "shuffle " + std::to_string(round));
        }
      });
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnTheRotationOfCorners) {
  ForEachCase(
      [](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        TestRandom random(43);
        for (int round = 0; round < 3; ++round) {
          ExpectSame(expected, MemoryMesh(Rotated(mesh, random)), options,
                     "rotation " + std::to_string(round));
        }
      });
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnTheCarrierOfVertices) {
  ForEachCase(
      [](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        ExpectSame(expected, MemoryMesh(mesh, Vertices::kFloat), options, "float vertices");
        ExpectSame(expected, MemoryMesh(mesh, Vertices::kNone), options, "no vertex list");
        TestRandom random(44);
        Triangles shuffled = mesh;
        random.Shuffle(shuffled);
        ExpectSame(expected, MemoryMesh(shuffled, Vertices::kNone), options,
                   "no vertex list, other order");
      });
}

TEST_F(Invariance, Promise3SamplesDoNotDependOnTheInstructionSet) {
  for (const std::string& target : SimdTargets()) {
    ForEachCase(
        [&](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
          ASSERT_TRUE(ForceSimdTarget(target));
          ExpectSame(expected, MemoryMesh(mesh), options, target);
          ASSERT_TRUE(ForceSimdTarget("auto"));
        });
  }
}

TEST_F(Invariance, CopiesOfTrianglesMoveNoSample) {
  ForEachCase(
      [](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        Triangles twice = mesh;
        twice.insert(twice.end(), mesh.begin(), mesh.end());
        TestRandom random(45);
        random.Shuffle(twice);
        MemoryMesh reader(twice);
        const SampleResult result = Sample(reader, options);
        EXPECT_TRUE(SameColumn(expected.samples.position, result.samples.position, "position"));
        EXPECT_TRUE(SameColumn(expected.samples.normal, result.samples.normal, "normal"));
        EXPECT_TRUE(SameColumn(expected.samples.cell, result.samples.cell, "cell"));
        EXPECT_EQ(result.stats.cells, expected.stats.cells);
      });
}

TEST_F(Invariance, UnreferencedVerticesChangeNothing) {
  constexpr double kMost = std::numeric_limits<double>::max();
  const Vec3 strays[] = {{0, 0, 0},       {1e3, -2e3, 3e3},       {1e30, 0, 0},
                         {0, 1e200, 0},   {kMost, -kMost, kMost}, {NAN, 1e5, 0},
                         {0, 0, INFINITY}};
  ForEachCase(
      [&](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        for (const Vec3& stray : strays) {
          MemoryMesh reader(mesh);
          reader.AddVertex(stray);
          reader.AddVertex(Vec3{} - stray);
          ExpectSame(expected, std::move(reader), options, "stray vertex " + Text(stray));
        }
      });
}

TEST_F(Invariance, UnreferencedVerticesBesideASingleTriangleChangeNothing) {
  const Triangles mesh = {{Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{0, 1, 0.5}}};
  for (const LatticeSpec& lattice : {LatticeSpec(Resolution{20}), LatticeSpec(Height{5})}) {
    SampleOptions options;
    options.lattice = lattice;
    MemoryMesh plain(mesh);
    const SampleResult expected = Sample(plain, options);
    for (const double far :
         {1e3, 1e30, 1e100, 1e155, 1e200, 1e300, std::numeric_limits<double>::max()}) {
      for (const int strays : {1, 2}) {
        MemoryMesh reader(mesh);
        reader.AddVertex({far, -far, 0.25 * far});
        if (strays == 2) reader.AddVertex({-far, far, far});
        ExpectSame(expected, std::move(reader), options,
                   std::to_string(strays) + " strays at " + Text({far, -far, 0.25 * far}));
      }
    }
  }
}

TEST_F(Invariance, SkippedTrianglesChangeNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  ForEachCase(
      [&](const Triangles& mesh, const SampleOptions& options, const SampleResult& expected) {
        Triangles soiled = mesh;
        soiled.push_back({Vec3{nan, 0, 0}, Vec3{1, 0, 0}, Vec3{0, 1, 0}});
        soiled.push_back({Vec3{0, 0, 0}, Vec3{inf, 0, 0}, Vec3{0, 1, 0}});
        soiled.push_back({Vec3{500, 0, 0}, Vec3{500, 0, 0}, Vec3{0, 1, 0}});
        soiled.push_back({Vec3{0, 0, 700}, Vec3{0, 0, 800}, Vec3{0, 0, 900}});
        soiled.push_back({Vec3{-inf, nan, 0}, Vec3{inf, 0, 0}, Vec3{0, 1, nan}});
        MemoryMesh reader(soiled);
        const SampleResult result = Sample(reader, options);
        EXPECT_TRUE(SameSamples(expected.samples, result.samples));
        EXPECT_TRUE(SameStats(expected.stats, result.stats));
        EXPECT_EQ(result.stats.skipped[static_cast<std::size_t>(SkipReason::kNonFinite)], 3u);
        EXPECT_EQ(result.stats.skipped[static_cast<std::size_t>(SkipReason::kZeroArea)], 2u);
        EXPECT_EQ(result.stats.sampled, mesh.size());
      });
}

TEST_F(Invariance, TheSeedChangesTheSamplesAndNothingElse) {
  ForEachCase([](const Triangles& mesh, SampleOptions options, const SampleResult& expected) {
    options.seed = 7;
    MemoryMesh reader(mesh);
    const SampleResult result = Sample(reader, options);
    EXPECT_FALSE(SameSamples(expected.samples, result.samples));
    EXPECT_EQ(result.stats.cells, expected.stats.cells);
    EXPECT_EQ(result.stats.cell_area, expected.stats.cell_area);
    EXPECT_EQ(result.stats.surface_hash, expected.stats.surface_hash);
  });
}

}  // namespace
}  // namespace strata::test
