#include "io/triangulate.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <utility>

namespace strata::io {
namespace {

using Polygon = std::vector<Vec3>;
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

Triangles Cut(const Polygon& polygon) {
  Triangles triangles;
  TriangulatePolygon(polygon, triangles);
  return triangles;
}

Vec3 AreaVector(const Polygon& p, const std::array<std::uint32_t, 3>& t) {
  return Cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]);
}

// If the triangles' edges cancel to the polygon's outline, every point is covered as often as the
// outline winds round it; if all turn the same way as well, a simple polygon is covered exactly
// once.
void ExpectEdgesCancelToOutline(const Polygon& polygon, const Triangles& triangles) {
  const auto n = static_cast<std::uint32_t>(polygon.size());
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  const auto add = [&](std::uint32_t a, std::uint32_t b) {
    if (edges[{b, a}] > 0) {
      --edges[{b, a}];
    } else {
      ++edges[{a, b}];
    }
  };
  for (const auto& t : triangles) add(t[0], t[1]), add(t[1], t[2]), add(t[2], t[0]);
  for (std::uint32_t i = 0; i < n; ++i) EXPECT_EQ((edges[{i, (i + 1) % n}]), 1) << "edge " << i;
  int total = 0;
  for (const auto& [edge, count] : edges) total += count;
  EXPECT_EQ(total, static_cast<int>(n));
}

void ExpectCoversOnce(const Polygon& polygon, Vec3 normal = {0, 0, 1}) {
  const Triangles triangles = Cut(polygon);
  ASSERT_EQ(triangles.size(), polygon.size() - 2);
  ExpectEdgesCancelToOutline(polygon, triangles);
  double shoelace = 0, sum = 0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    shoelace += Dot(Cross(polygon[i], polygon[(i + 1) % polygon.size()]), normal);
  }
  for (const auto& t : triangles) {
    const double area = Dot(AreaVector(polygon, t), normal);
    EXPECT_GT(area * shoelace, 0) << t[0] << ' ' << t[1] << ' ' << t[2];
    sum += area;
  }
  EXPECT_NEAR(sum, shoelace, 1e-9 * std::abs(shoelace));
}

// The triangles as coordinates, in an order that does not depend on the corners' numbers.
std::vector<std::array<double, 9>> Canonical(const Polygon& polygon) {
  std::vector<std::array<double, 9>> result;
  for (const auto& t : Cut(polygon)) {
    std::array<std::array<double, 3>, 3> c;
    for (int k = 0; k < 3; ++k) c[k] = {polygon[t[k]].x, polygon[t[k]].y, polygon[t[k]].z};
    // The least of the three rotations, as corners may coincide.
    auto least = c;
    for (int k = 0; k < 2; ++k) {
      std::rotate(c.begin(), c.begin() + 1, c.end());
      least = std::min(least, c);
    }
    c = least;
    result.push_back(
        {c[0][0], c[0][1], c[0][2], c[1][0], c[1][1], c[1][2], c[2][0], c[2][1], c[2][2]});
  }
  std::sort(result.begin(), result.end());
  return result;
}

void ExpectSameFromEveryCorner(Polygon polygon) {
  const auto expected = Canonical(polygon);
  for (std::size_t k = 1; k < polygon.size(); ++k) {
    std::rotate(polygon.begin(), polygon.begin() + 1, polygon.end());
    EXPECT_EQ(Canonical(polygon), expected) << "rotated by " << k;
  }
}

double TurnXy(Vec3 a, Vec3 b, Vec3 c) { return Cross(b - a, c - a).z; }

bool SegmentsTouch(Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  const auto on = [](Vec3 p, Vec3 q, Vec3 r) {
    return TurnXy(p, q, r) == 0 && std::min(p.x, q.x) <= r.x && r.x <= std::max(p.x, q.x) &&
           std::min(p.y, q.y) <= r.y && r.y <= std::max(p.y, q.y);
  };
  if (on(a, b, c) || on(a, b, d) || on(c, d, a) || on(c, d, b)) return true;
  return (TurnXy(a, b, c) > 0) != (TurnXy(a, b, d) > 0) &&
         (TurnXy(c, d, a) > 0) != (TurnXy(c, d, b) > 0);
}

// A simple polygon on an integer grid, grown by putting corners into random edges where they cross
// nothing. The small grid makes collinear corners common.
Polygon RandomSimplePolygon(std::mt19937_64& random, std::size_t corners, int grid) {
  std::uniform_int_distribution<int> coordinate(0, grid);
  const auto point = [&] {
    return Vec3{double(coordinate(random)), double(coordinate(random)), 0};
  };
  Polygon p;
  do {
    p = {point(), point(), point()};
  } while (TurnXy(p[0], p[1], p[2]) == 0);
  for (int tries = 0; p.size() < corners && tries < 20000; ++tries) {
    const std::size_t n = p.size(), at = random() % n;
    const Vec3 a = p[at], b = p[(at + 1) % n], q = point();
    bool free = q != a && q != b;
    for (std::size_t k = 0; k < n && free; ++k) {
      if (k == at) continue;
      const Vec3 c = p[k], d = p[(k + 1) % n];
      // The neighbouring edges share a corner with the new ones; only their other end may not
      // touch.
      if (d == a) {
        free =
            !SegmentsTouch(q, b, c, d) && !SegmentsTouch(a, q, c, c) && !SegmentsTouch(c, d, q, q);
      } else if (c == b) {
        free =
            !SegmentsTouch(a, q, c, d) && !SegmentsTouch(q, b, d, d) && !SegmentsTouch(c, d, q, q);
      } else {
        free = !SegmentsTouch(a, q, c, d) && !SegmentsTouch(q, b, c, d);
      }
    }
    if (free) p.insert(p.begin() + static_cast<std::ptrdiff_t>(at) + 1, q);
  }
  return p;
}

Polygon Star(std::mt19937_64& random, int corners) {
  std::uniform_real_distribution<double> radius(0.1, 1);
  Polygon p;
  for (int i = 0; i < corners; ++i) {
    const double angle = 2 * M_PI * i / corners, r = radius(random);
    p.push_back({r * std::cos(angle), r * std::sin(angle), 0});
  }
  return p;
}

Polygon Spiral(int turns, int per_turn) {
  Polygon p;
  const int n = turns * per_turn;
  for (int i = 0; i <= n; ++i) {
    const double a = 2 * M_PI * i / per_turn, r = 1.0 + i / double(per_turn);
    p.push_back({r * std::cos(a), r * std::sin(a), 0});
  }
  for (int i = n; i >= 0; --i) {
    const double a = 2 * M_PI * i / per_turn, r = 0.6 + i / double(per_turn);
    p.push_back({r * std::cos(a), r * std::sin(a), 0});
  }
  return p;
}

Polygon Comb(int teeth, double skew) {
  Polygon p{{0, -1, 0}, {2.0 * teeth, -1, 0}};
  for (int i = teeth; i-- > 0;) {
    p.push_back({2.0 * i + 2 - 0.5, 0, 0});
    p.push_back({2.0 * i + 1 + skew, 50.0, 0});
    p.push_back({2.0 * i + 0.5, 0, 0});
  }
  return p;
}

TEST(TriangulatePolygon, GivesNothingForFewerThanThreeCorners) {
  EXPECT_TRUE(Cut({}).empty());
  EXPECT_TRUE(Cut({{0, 0, 0}}).empty());
  EXPECT_TRUE(Cut({{0, 0, 0}, {1, 0, 0}}).empty());
}

TEST(TriangulatePolygon, LeavesATriangleAsItIs) {
  EXPECT_EQ(Cut({{5, 0, 0}, {1, 0, 0}, {0, 1, 0}}), (Triangles{{0, 1, 2}}));
}

TEST(TriangulatePolygon, AppendsToWhatIsThere) {
  Triangles out{{7, 8, 9}};
  TriangulatePolygon(Polygon{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, out);
  EXPECT_EQ(out, (Triangles{{7, 8, 9}, {0, 1, 2}}));
}

TEST(TriangulatePolygon, CutsAConvexQuadAlongTheShorterDiagonal) {
  const Polygon kite{{-1, 0, 0}, {0, -3, 0}, {1, 0, 0}, {0, 3, 0}};
  for (const auto& t : Cut(kite)) {
    EXPECT_EQ(std::count(t.begin(), t.end(), 0u), 1);
    EXPECT_EQ(std::count(t.begin(), t.end(), 2u), 1);
  }
  ExpectSameFromEveryCorner(kite);
  ExpectSameFromEveryCorner({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}});
}

TEST(TriangulatePolygon, CutsAConcaveQuadAtItsReflexCorner) {
  const Polygon dart{{0, 0, 0}, {4, -1, 0}, {1, 0, 0}, {4, 1, 0}};
  ExpectCoversOnce(dart);
  ExpectSameFromEveryCorner(dart);
  ExpectCoversOnce({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {1, 1, 0}});
}

TEST(TriangulatePolygon, CoversRandomSimplePolygonsOnce) {
  for (std::uint64_t seed = 1; seed <= 400; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    const int grid = seed % 2 == 0 ? 8 : 1000;
    Polygon p = RandomSimplePolygon(random, 4 + random() % 60, grid);
    ExpectCoversOnce(p);
    if (seed % 10 == 0) ExpectSameFromEveryCorner(p);
    std::reverse(p.begin(), p.end());
    ExpectCoversOnce(p);
    if (HasFailure()) break;
  }
}

TEST(TriangulatePolygon, CoversRandomStars) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    const Polygon p = Star(random, 5 + static_cast<int>(random() % 1000));
    ExpectCoversOnce(p);
  }
}

TEST(TriangulatePolygon, CoversSpiralsAndCombs) {
  for (const int per_turn : {4, 7, 60}) {
    for (const int turns : {1, 3, 20}) ExpectCoversOnce(Spiral(turns, per_turn));
  }
  for (const double skew : {0.0, 0.3, 200.0}) ExpectCoversOnce(Comb(300, skew));
}

TEST(TriangulatePolygon, CoversAHoleJoinedByABridge) {
  const Polygon keyhole{{0, 0, 0}, {9, 0, 0}, {9, 9, 0}, {0, 9, 0}, {0, 0, 0},
                        {3, 3, 0}, {3, 6, 0}, {6, 6, 0}, {6, 3, 0}, {3, 3, 0}};
  ExpectCoversOnce(keyhole);
  ExpectSameFromEveryCorner(keyhole);
}

TEST(TriangulatePolygon, WorksInAnyPlane) {
  std::mt19937_64 random(11);
  for (const auto& [u, v] : {std::pair<Vec3, Vec3>{{1, 0, 0}, {0, 0, 1}},
                             {{0, 1, 0}, {0, 0, 1}},
                             {{1, 1, 0}, {0, 1, 1}},
                             {{3, -1, 2}, {-1, 2, 5}}}) {
    Polygon flat = RandomSimplePolygon(random, 40, 50), p;
    for (const Vec3& q : flat) p.push_back(u * q.x + v * q.y);
    ExpectCoversOnce(p, Cross(u, v));
  }
}

TEST(TriangulatePolygon, CoversFarFromTheOriginToo) {
  std::mt19937_64 random(5);
  Polygon p = RandomSimplePolygon(random, 50, 30);
  for (Vec3& q : p) q = q + Vec3{5e8, -3e8, 1e7};
  const Triangles triangles = Cut(p);
  double smallest = 1e300, largest = -1e300;
  for (const auto& t : triangles) {
    smallest = std::min(smallest, AreaVector(p, t).z);
    largest = std::max(largest, AreaVector(p, t).z);
  }
  EXPECT_GT(smallest * largest, 0);
}

TEST(TriangulatePolygon, GivesAllTrianglesForDegeneratePolygons) {
  const double inf = std::numeric_limits<double>::infinity(), nan = std::nan("");
  const std::vector<Polygon> polygons = {
      {{1, 1, 1}, {1, 1, 1}, {1, 1, 1}, {1, 1, 1}},
      {{1, 1, 1}, {1, 1, 1}, {1, 1, 1}, {1, 1, 1}, {1, 1, 1}, {1, 1, 1}},
      {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {3, 0, 0}, {4, 0, 0}},
      {{0, 0, 0}, {2, 2, 0}, {2, 0, 0}, {0, 2, 0}},
      {{0, 0, 0}, {4, 4, 0}, {4, 0, 0}, {0, 4, 0}, {2, 9, 0}, {2, -3, 0}, {1, 1, 0}},
      {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {nan, 1, 0}, {0, 1, 0}},
      {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {inf, 1, 0}, {0, 1, 0}},
      {{0, 0, 0}, {1e300, 0, 0}, {1e300, 1e300, 0}, {3, 1e300, 0}, {0, 1e308, 0}},
      {{0, 0, 0}, {1e-300, 0, 0}, {1e-300, 1e-300, 0}, {0, 1e-300, 0}, {0, 5e-301, 0}},
      {{0, 0, 0}, {4, 0, 0}, {4, 0, 0}, {4, 4, 0}, {8, 8, 0}, {4, 4, 0}, {0, 4, 0}},
  };
  for (const Polygon& p : polygons) {
    SCOPED_TRACE(&p - polygons.data());
    const Triangles triangles = Cut(p);
    EXPECT_EQ(triangles.size(), p.size() - 2);
    ExpectEdgesCancelToOutline(p, triangles);
    const bool finite = std::all_of(p.begin(), p.end(), [](Vec3 q) {
      return std::isfinite(q.x) && std::isfinite(q.y) && std::isfinite(q.z);
    });
    if (finite) ExpectSameFromEveryCorner(p);
  }
}

TEST(TriangulatePolygon, GivesTheSameForRandomScribblesFromEveryCorner) {
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937_64 random(seed);
    Polygon p(4 + random() % 30);
    for (Vec3& q : p) {
      q = {double(random() % 6), double(random() % 6), seed % 2 == 0 ? 0.0 : double(random() % 6)};
    }
    const Triangles triangles = Cut(p);
    ASSERT_EQ(triangles.size(), p.size() - 2);
    ExpectEdgesCancelToOutline(p, triangles);
    ExpectSameFromEveryCorner(p);
    if (HasFailure()) break;
  }
}

// The sum of the triangles' areas over the area of their signed sum: 1 if none turns the wrong way.
double Covering(const Polygon& p) {
  const Triangles triangles = Cut(p);
  EXPECT_EQ(triangles.size(), p.size() - 2);
  double covered = 0, sum = 0;
  for (const auto& t : triangles) {
    covered += std::abs(AreaVector(p, t).z);
    sum += AreaVector(p, t).z;
  }
  return covered / std::abs(sum);
}

TEST(TriangulatePolygon, CoversHugeSimplePolygonsWithinItsBoundOfWork) {
  std::mt19937_64 random(3);
  Polygon circle;
  for (int i = 0; i < 1000000; ++i) {
    circle.push_back({std::cos(2e-6 * M_PI * i), std::sin(2e-6 * M_PI * i), 0});
  }
  EXPECT_NEAR(Covering(circle), 1, 1e-6);
  EXPECT_NEAR(Covering(Star(random, 100000)), 1, 1e-6);
  EXPECT_NEAR(Covering(Spiral(100, 1000)), 1, 1e-6);
  EXPECT_NEAR(Covering(Comb(100000, 0)), 1, 1e-6);
  EXPECT_NEAR(Covering(Comb(100000, 50000)), 1, 1e-6);
}

TEST(TriangulatePolygon, EndsOnHugeScribbles) {
  std::mt19937_64 random(3);
  Polygon scribble(100000);
  for (Vec3& q : scribble) q = {double(random() % 100000), double(random() % 100000), 0};
  EXPECT_EQ(Cut(scribble).size(), scribble.size() - 2);
}

}  // namespace
}  // namespace strata::io
