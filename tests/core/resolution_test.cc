// --resolution's lattice treats the faces of a box alike.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/sample_mesh.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

Triangles Box(Vec3 low, Vec3 high) {
  Triangles mesh;
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      Vec3 c[4];
      for (int k = 0; k < 4; ++k) {
        c[k][axis] = side ? high[axis] : low[axis];
        c[k][u] = (k == 1 || k == 2) ? high[u] : low[u];
        c[k][v] = k >= 2 ? high[v] : low[v];
      }
      mesh.push_back({c[0], c[1], c[2]});
      mesh.push_back({c[0], c[2], c[3]});
    }
  }
  return mesh;
}

// Samples per unit area on the six faces, told apart by position.
std::array<double, 6> Densities(Vec3 low, Vec3 high, const SampleOptions& options) {
  MemoryMesh mesh(Box(low, high));
  RunContext context;
  const auto result = SampleMesh(mesh, options, context);
  EXPECT_TRUE(result) << result.error().message;
  std::array<double, 6> count{};
  const Vec3 side = high - low;
  for (const Vec3& p : result->samples.position) {
    int face = 0;
    double best = HUGE_VAL;
    for (int k = 0; k < 6; ++k) {
      const double plane = k % 2 ? high[k / 2] : low[k / 2];
      const double away = std::fabs(p[k / 2] - plane) / side[k / 2];
      if (away < best) best = away, face = k;
    }
    ++count[static_cast<std::size_t>(face)];
  }
  for (int k = 0; k < 6; ++k) {
    count[static_cast<std::size_t>(k)] /= side[(k / 2 + 1) % 3] * side[(k / 2 + 2) % 3];
  }
  return count;
}

double Spread(const std::array<double, 6>& densities) {
  const auto [least, most] = std::minmax_element(densities.begin(), densities.end());
  return *most / *least - 1;
}

TEST(ResolutionLattice, GivesTheFacesOfACubeTheSameDensity) {
  for (const std::uint32_t n : {100u, 200u}) {
    for (const double lambda : {0.0, 5.0, 60.0}) {
      for (const double m : {0.0, 0.5}) {
        SampleOptions options;
        options.lattice = Resolution{n};
        options.lambda = lambda;
        options.min_distance = m;
        for (const Vec3 low : {Vec3{0, 0, 0}, Vec3{1.0 / 3, -0.1, 1e6 + 0.1}}) {
          EXPECT_LT(Spread(Densities(low, low + Vec3{1, 1, 1}, options)), 0.03)
              << "N " << n << ", lambda " << lambda << ", m " << m << ", corner " << low.x;
        }
      }
    }
  }
}

TEST(ResolutionLattice, DoublesAndThinsNoFaceOfACubeAtAnyN) {
  for (std::uint32_t n = 4; n <= 64; ++n) {
    SampleOptions options;
    options.lattice = Resolution{n};
    options.min_distance = 0;
    const auto densities = Densities({0, 0, 0}, {1, 1, 1}, options);
    // A face shares 4 n cells at its edges with others, and chance decides whose sample they hold.
    const double slack = 4.0 / n;
    for (const double density : densities) {
      EXPECT_GT(density, (1 - slack) * n * n * 0.9) << "N " << n;
      EXPECT_LT(density, (1 + slack) * n * n) << "N " << n;
    }
  }
}

TEST(ResolutionLattice, DoublesAndThinsNoFaceOfABox) {
  for (const Vec3 side : {Vec3{1, 0.5, 0.25}, Vec3{0.3, 1, 0.7}, Vec3{0.9999, 1, 0.6180339887}}) {
    for (const std::uint32_t n : {97u, 128u, 200u}) {
      SampleOptions options;
      options.lattice = Resolution{n};
      options.min_distance = 0;
      EXPECT_LT(Spread(Densities({0, 0, 0}, side, options)), 0.12)
          << "side " << side.x << ' ' << side.y << ' ' << side.z << ", N " << n;
    }
  }
}

TEST(ResolutionLattice, HasNCellsAlongTheLongestSide) {
  for (const std::uint32_t n : {1u, 2u, 7u, 128u}) {
    MemoryMesh mesh(Box({0, 0, 0}, {1, 0.5, 0.5}));
    SampleOptions options;
    options.lattice = Resolution{n};
    options.min_distance = 0;
    options.attributes = kCell;
    RunContext context;
    const auto result = SampleMesh(mesh, options, context);
    ASSERT_TRUE(result);
    const auto [least, most] =
        std::minmax_element(result->samples.cell.begin(), result->samples.cell.end(),
                            [](const Cell& a, const Cell& b) { return a.x < b.x; });
    EXPECT_EQ(most->x - least->x + 1, static_cast<int>(n));
  }
}

}  // namespace
}  // namespace strata::test
