// Elementary functions, hashes and random numbers: what every sample is made of.
#include "core/numeric.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>
#include <set>
#include <string>

#include "core/random_stream.h"
#include "core/triangle_hash.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

constexpr long double kUlp = 0x1p-53L;

// Error in units of half the distance between doubles near the true value.
long double ErrorInUlps(double value, long double truth) {
  return std::fabs((static_cast<long double>(value) - truth) / truth) / kUlp;
}

TEST(Numeric, ExpIsWithinAFewUnitsInTheLastPlace) {
  TestRandom random(91);
  long double worst = 0;
  for (int i = 0; i < 300000; ++i) {
    const double x = i % 2 ? random.In(-700, 700) : random.In(-2, 2);
    worst = std::max(worst, ErrorInUlps(Exp(x), std::exp(static_cast<long double>(x))));
  }
  EXPECT_LT(worst, 4);
  std::printf("worst relative error of Exp: %.2Lf * 2^-53\n", worst);
  EXPECT_EQ(Exp(0), 1);
  EXPECT_EQ(Exp(-701), 0);
  EXPECT_EQ(Exp(-HUGE_VAL), 0);
  EXPECT_GT(Exp(-700), 0);
  EXPECT_TRUE(std::isfinite(Exp(700)));
}

TEST(Numeric, ExpNeverFallsAsItsArgumentGrows) {
  // Bounds of the density are taken at the nearest point, so order matters more than the last bit.
  TestRandom random(92);
  for (int i = 0; i < 300000; ++i) {
    const double x = random.In(-433, 0);
    EXPECT_LE(Exp(x), Exp(x + 1e-13 * -x + 1e-15) * (1 + 1e-15));
  }
}

TEST(Numeric, LogIsWithinAFewUnitsInTheLastPlace) {
  TestRandom random(93);
  long double worst = 0;
  for (int i = 0; i < 300000; ++i) {
    const double x = i % 3 == 0   ? random.LogIn(1e-300, 1e300)
                     : i % 3 == 1 ? 1 - random.Unit() * 0x1p-3
                                  : random.In(0.5, 2);
    if (x == 1) continue;
    worst = std::max(worst, ErrorInUlps(Log(x), std::log(static_cast<long double>(x))));
  }
  EXPECT_LT(worst, 6);
  std::printf("worst relative error of Log: %.2Lf * 2^-53\n", worst);
  EXPECT_EQ(Log(1), 0);
}

TEST(Numeric, NegLogOneMinusIsAccurateForSmallNumbers) {
  TestRandom random(94);
  EXPECT_EQ(NegLogOneMinus(0), 0);
  for (int shift = 0; shift < 53; ++shift) {
    for (int i = 0; i < 200; ++i) {
      const double v = std::floor(random.In(1, 2) * std::ldexp(1, 52 - shift)) * 0x1p-53;
      if (!(v > 0 && v < 1)) continue;
      const long double truth = -std::log1p(-static_cast<long double>(v));
      EXPECT_LT(ErrorInUlps(NegLogOneMinus(v), truth), 6) << v;
    }
  }
  EXPECT_NEAR(NegLogOneMinus(1 - 0x1p-53), 53 * std::log(2.0), 1e-13);
}

TEST(Numeric, SinCosOfTurnsIsWithinAFewUnitsInTheLastPlace) {
  TestRandom random(95);
  long double worst = 0;
  for (int i = 0; i < 300000; ++i) {
    const double turns = random.Unit();
    const long double angle = 2 * std::numbers::pi_v<long double> * turns;
    const SinCos got = SinCosOfTurns(turns);
    worst = std::max(
        {worst, std::fabs(got.sin - std::sin(angle)), std::fabs(got.cos - std::cos(angle))});
  }
  EXPECT_LT(worst, 4 * kUlp);
  for (const double turns : {0.0, 0.25, 0.5, 0.75, 1.0}) {
    const SinCos got = SinCosOfTurns(turns);
    EXPECT_EQ(got.sin, turns == 0.25 ? 1 : turns == 0.75 ? -1 : 0) << turns;
    EXPECT_EQ(got.cos, turns == 0.5 ? -1 : turns == 0 || turns == 1 ? 1 : 0) << turns;
  }
}

TEST(Numeric, FloorAndCeilingAreExactAtIntegers) {
  for (const double x : {-2147483647.0, -3.0, -1.0, -0.0, 0.0, 1.0, 5.0, 2147483646.0}) {
    EXPECT_EQ(FloorToInt(x), static_cast<std::int32_t>(std::floor(x)));
    EXPECT_EQ(CeilToInt(x), static_cast<std::int32_t>(std::ceil(x)));
    for (const double to : {-HUGE_VAL, HUGE_VAL}) {
      const double y = std::nextafter(x, to);
      EXPECT_EQ(FloorToInt(y), static_cast<std::int32_t>(std::floor(y))) << y;
      if (y > 2147483646.0) continue;
      EXPECT_EQ(CeilToInt(y), static_cast<std::int32_t>(std::ceil(y))) << y;
    }
  }
}

TEST(TriangleHash, IsTheSameForTheThreeRotationsOnly) {
  TestRandom random(96);
  for (int i = 0; i < 10000; ++i) {
    std::uint64_t h[3];
    for (std::uint64_t& v : h) v = HashVertex(random.InBox({-1, -1, -1}, {1, 1, 1}));
    const std::uint64_t hash = HashTriangle(h[0], h[1], h[2]);
    EXPECT_EQ(hash, HashTriangle(h[1], h[2], h[0]));
    EXPECT_EQ(hash, HashTriangle(h[2], h[0], h[1]));
    EXPECT_NE(hash, HashTriangle(h[0], h[2], h[1]));
    const int first = CanonicalFirst(h[0], h[1], h[2]);
    EXPECT_EQ((CanonicalFirst(h[1], h[2], h[0]) + 1) % 3, first);
    EXPECT_EQ((CanonicalFirst(h[2], h[0], h[1]) + 2) % 3, first);
  }
}

TEST(TriangleHash, TakesMinusZeroForZero) {
  EXPECT_EQ(HashVertex({-0.0, -0.0, -0.0}), HashVertex({0, 0, 0}));
  EXPECT_EQ(HashVertex({1, -0.0, 2}), HashVertex({1, 0, 2}));
  EXPECT_NE(HashVertex({1, 0, 2}), HashVertex({1, 5e-324, 2}));
}

TEST(TriangleHash, TellsAxesApart) {
  std::set<std::uint64_t> hashes;
  for (int x = -5; x <= 5; ++x) {
    for (int y = -5; y <= 5; ++y) {
      for (int z = -5; z <= 5; ++z) hashes.insert(HashVertex({double(x), double(y), double(z)}));
    }
  }
  EXPECT_EQ(hashes.size(), 11u * 11 * 11);
}

// Meshes on a grid have coordinates with few bits; their triangles need different names all the
// same.
TEST(TriangleHash, HasNoCollisionsAmongTrianglesOfAGrid) {
  std::set<std::uint64_t> hashes;
  constexpr int kSide = 400;
  const auto at = [](int x, int y) { return HashVertex({x * 0.5, y * 0.5, 0}); };
  for (int x = 0; x < kSide; ++x) {
    for (int y = 0; y < kSide; ++y) {
      hashes.insert(HashTriangle(at(x, y), at(x + 1, y), at(x + 1, y + 1)));
      hashes.insert(HashTriangle(at(x, y), at(x + 1, y + 1), at(x, y + 1)));
    }
  }
  EXPECT_EQ(hashes.size(), 2u * kSide * kSide);
}

TEST(RandomStream, RepeatsItsAnswersAndDiffersByEveryPartOfItsKey) {
  const RandomStream a(1, 2, {3, 4, 5}, 6);
  EXPECT_EQ(a(7), RandomStream(1, 2, {3, 4, 5}, 6)(7));
  std::set<RandomStream::Block> blocks = {a(7), a(8)};
  blocks.insert(RandomStream(1ull << 40, 2, {3, 4, 5}, 6)(7));
  blocks.insert(RandomStream(1, 2ull << 40, {3, 4, 5}, 6)(7));
  blocks.insert(RandomStream(1, 2, {4, 4, 5}, 6)(7));
  blocks.insert(RandomStream(1, 2, {3, 5, 5}, 6)(7));
  blocks.insert(RandomStream(1, 2, {3, 4, 6}, 6)(7));
  blocks.insert(RandomStream(1, 2, {3, 4, 5}, 7)(7));
  EXPECT_EQ(blocks.size(), 8u);
}

TEST(RandomStream, UniformsStayBelowOneAndAboveTheirFirstWord) {
  EXPECT_EQ(UniformFrom(0u, 0u), 0);
  EXPECT_LT(UniformFrom(~0u, ~0u), 1);
  EXPECT_EQ(UniformFrom(~0u, ~0u), 1 - 0x1p-53);
  EXPECT_GE(UniformFrom(12345u, 0u), 12345 * 0x1p-32);
  EXPECT_GT(UniformFrom(0u), 0);
  EXPECT_LT(UniformFrom(~0u), 1);
}

}  // namespace
}  // namespace strata::test
