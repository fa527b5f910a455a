// The first arrival on a piece: exponential in time at the rate of the density's integral, and a
// function of its arguments alone.
#include "core/race.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>

#include "tests/support/memory_mesh.h"
#include "tests/support/statistics.h"
#include "tests/support/surface_law.h"

namespace strata::test {
namespace {

constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr double kLambdas[] = {0, 0.5, 2, 5, 20, 60, 200, 500};

struct Piece {
  Polygon polygon;
  Vec3 normal;
  double area = 0;
};

Piece MakePiece(const LongPolygon& corners, Vec3 normal) {
  Piece piece;
  for (const LongVec& c : corners) {
    piece.polygon.Push(
        {static_cast<double>(c.x), static_cast<double>(c.y), static_cast<double>(c.z)});
  }
  piece.normal = normal;
  piece.area = AreaOf(piece.polygon, normal);
  return piece;
}

// What a plane leaves in a cell, or a triangle of any size and shape, cut by the cell.
Piece RandomPiece(TestRandom& random) {
  for (;;) {
    Triangle t;
    if (random.Unit() < 0.3) {
      const Vec3 n = random.Direction(), at = n * random.In(-0.8, 0.8);
      const Vec3 u = Cross(n, random.Direction()), v = Cross(n, u);
      t = {at + u * 9, at - u * 9 + v * 9, at - u * 9 - v * 9};
    } else {
      const Vec3 at = random.InBox({-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5});
      const double size = random.LogIn(1e-3, 2);
      t = {at, at + random.Direction() * size,
           at + random.Direction() * (size * random.LogIn(1e-4, 1))};
    }
    const Vec3 n = Cross(t[1] - t[0], t[2] - t[0]);
    const LongPolygon part = ClipToBox(ToLong(t), {-0.5L, -0.5L, -0.5L}, {0.5L, 0.5L, 0.5L});
    if (part.size() < 3 || part.size() > 16) continue;
    const Piece piece = MakePiece(part, n * (1 / Norm(n)));
    if (piece.area > 1e-9) return piece;
  }
}

RandomStream StreamOf(std::uint64_t number) {
  return {1234, number * 0x9e3779b97f4a7c15, {1, 2, 3}, 7};
}

LongPolygon CornersOf(const Polygon& polygon) {
  LongPolygon corners;
  for (int k = 0; k < polygon.size; ++k) {
    corners.push_back({polygon[k].x, polygon[k].y, polygon[k].z});
  }
  return corners;
}

TEST(FirstArrival, ComesAfterAnExponentialTimeAtTheRateOfTheIntegral) {
  for (const double lambda : kLambdas) {
    // The quadrature is slow where the density is steep.
    const int pieces = lambda > 60 ? 40 : 200, draws = 12000 / pieces;
    TestRandom random(81);
    std::vector<double> uniform;
    for (int i = 0; i < pieces; ++i) {
      const Piece piece = RandomPiece(random);
      const double rate = IntegralOfDensity(CornersOf(piece.polygon), lambda);
      for (int draw = 0; draw < draws; ++draw) {
        const auto arrival =
            DrawFirstArrival(piece.polygon, piece.normal, piece.area, lambda,
                             StreamOf(static_cast<std::uint64_t>(i * draws + draw)), kNever);
        ASSERT_TRUE(arrival);
        uniform.push_back(-std::expm1(-rate * arrival->time));
      }
    }
    const double p = UniformKsPValue(uniform);
    std::printf("lambda %g, seed 81: %zu arrivals, Kolmogorov-Smirnov p = %.3g\n", lambda,
                uniform.size(), p);
    EXPECT_GT(p, 1e-6) << "lambda " << lambda;
  }
}

TEST(FirstArrival, LiesOnThePiece) {
  TestRandom random(82);
  for (const double lambda : kLambdas) {
    for (int i = 0; i < 2000; ++i) {
      const Piece piece = RandomPiece(random);
      const auto arrival = DrawFirstArrival(piece.polygon, piece.normal, piece.area, lambda,
                                            StreamOf(static_cast<std::uint64_t>(i)));
      ASSERT_TRUE(arrival);
      EXPECT_NEAR(Dot(arrival->local - piece.polygon[0], piece.normal), 0, 1e-12);
      for (int k = 0; k < piece.polygon.size; ++k) {
        const Vec3 a = piece.polygon[k], b = piece.polygon[(k + 1) % piece.polygon.size];
        const double length = Norm(b - a);
        if (length < 1e-9) continue;
        const double inside = Dot(piece.normal, Cross(b - a, arrival->local - a)) / length;
        EXPECT_GT(inside, -1e-12) << "lambda " << lambda << ", piece " << i;
      }
    }
  }
}

TEST(FirstArrival, RivalsOnlySaveTheWorkOfLosing) {
  TestRandom random(83);
  for (const double lambda : kLambdas) {
    for (int i = 0; i < 2000; ++i) {
      const Piece piece = RandomPiece(random);
      const RandomStream stream = StreamOf(static_cast<std::uint64_t>(i));
      const auto draw = [&](double rival) {
        return DrawFirstArrival(piece.polygon, piece.normal, piece.area, lambda, stream, rival);
      };
      const auto alone = draw(kNever);
      ASSERT_TRUE(alone);
      for (const double rival :
           {alone->time, std::nextafter(alone->time, kNever), 2 * alone->time, 1e300}) {
        const auto again = draw(rival);
        ASSERT_TRUE(again) << "lambda " << lambda << ", piece " << i;
        EXPECT_EQ(again->time, alone->time);
        EXPECT_EQ(again->local, alone->local);
      }
      for (const double rival : {std::nextafter(alone->time, 0.0), 0.5 * alone->time, 0.0}) {
        EXPECT_FALSE(draw(rival)) << "lambda " << lambda << ", piece " << i;
      }
    }
  }
}

TEST(FirstArrival, ComesOnSliversAndFarPiecesWithoutARival) {
  // Where one envelope alone would need any number of proposals.
  const double widths[] = {1e-1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-100};
  TestRandom random(84);
  for (const double lambda : {5.0, 60.0, 500.0}) {
    for (const double width : widths) {
      for (int i = 0; i < 100; ++i) {
        const Vec3 d = random.Direction();
        const Vec3 far{0.5, 0.5, i % 2 ? 0.5 : -0.5};
        const Vec3 from = i % 3 ? far : d * -0.4, to = i % 3 ? Vec3{0.5, -0.5, 0.1} : d * 0.4;
        const Vec3 across = Cross(to - from, random.Direction());
        Piece piece;
        piece.polygon.Push(from);
        piece.polygon.Push(to);
        piece.polygon.Push((from + to) * 0.5 + across * (width / Norm(across)));
        const Vec3 n = Cross(to - from, across);
        piece.normal = n * (1 / Norm(n));
        piece.area = 0.5 * Norm(to - from) * width;
        const auto arrival = DrawFirstArrival(piece.polygon, piece.normal, piece.area, lambda,
                                              StreamOf(static_cast<std::uint64_t>(i)));
        ASSERT_TRUE(arrival);
        EXPECT_TRUE(std::isfinite(arrival->time)) << "lambda " << lambda << ", width " << width;
        EXPECT_LE(Norm(arrival->local), 0.867);
      }
    }
  }
}

TEST(FirstArrival, IsTheSameWhenAskedAgain) {
  TestRandom random(85);
  for (int i = 0; i < 500; ++i) {
    const Piece piece = RandomPiece(random);
    const RandomStream stream = StreamOf(static_cast<std::uint64_t>(i));
    const auto a = DrawFirstArrival(piece.polygon, piece.normal, piece.area, 20, stream);
    const auto b = DrawFirstArrival(piece.polygon, piece.normal, piece.area, 20, stream);
    ASSERT_TRUE(a && b);
    EXPECT_EQ(a->time, b->time);
    EXPECT_EQ(a->local, b->local);
  }
}

}  // namespace
}  // namespace strata::test
