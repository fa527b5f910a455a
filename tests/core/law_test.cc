// Promise 1: in a cell the sample's density is proportional to exp(-lambda d) on the surface inside
// that cell.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "tests/core/law_cases.h"

namespace strata::test {
namespace {

constexpr double kLambdas[] = {0, 2, 5, 20, 60};
constexpr std::uint64_t kSamples = 1'000'000;
// These cost more; the five values of lambda together have as many or more.
constexpr std::uint64_t kSliverSamples = 200'000;
constexpr std::uint64_t kSoupSamples = 500'000;
// Seeds are fixed, so a test that passes once always passes; a biased sampler would have to be
// lucky in a million to stay above this.
constexpr double kLeastP = 1e-6;
constexpr double kMostSigma = 5;

void ExpectLaw(const LawCase& law_case, std::uint64_t samples) {
  for (const double lambda : kLambdas) {
    const LawTable table = DrawUntil(law_case, lambda, lambda, samples);
    const ChiSquare fit = table.Test();
    std::printf("%s, lambda %g, seeds from 1: chi-square %.1f, %g degrees of freedom, p = %.3g\n",
                law_case.name.c_str(), lambda, fit.statistic, fit.freedom, fit.p_value());
    EXPECT_GT(fit.p_value(), kLeastP) << law_case.name << ", lambda " << lambda;
    const Moments scores = table.Scores();
    for (std::size_t k = 0; k < kMomentCount; ++k) {
      EXPECT_LT(std::fabs(scores[k]), kMostSigma)
          << law_case.name << ", lambda " << lambda << ", mean of " << kMomentNames[k];
    }
    EXPECT_GT(fit.freedom, 10) << "the table is too coarse to see anything";
    EXPECT_EQ(table.strangers(), 0u) << "samples in cells without surface";
  }
}

TEST(Promise1ExactLaw, HoldsOnAPlaneThroughTheCentres) {
  ExpectLaw(PlaneThroughCentres(200), kSamples);
}
TEST(Promise1ExactLaw, HoldsOnAnObliquePlane) { ExpectLaw(ObliquePlane(150), kSamples); }
TEST(Promise1ExactLaw, HoldsOnAPlaneInAFanOfSlivers) {
  ExpectLaw(FanOfSlivers(250), kSliverSamples);
}
TEST(Promise1ExactLaw, HoldsOnAPlaneInStrips) { ExpectLaw(StripSlivers(250), kSliverSamples); }
TEST(Promise1ExactLaw, HoldsOnNeedlesWithinCells) {
  ExpectLaw(NeedlesInCells(100), kSliverSamples);
}
TEST(Promise1ExactLaw, HoldsOnAnObliquePlaneInStrips) {
  ExpectLaw(ObliqueSlivers(100), kSliverSamples);
}
TEST(Promise1ExactLaw, HoldsAtCornersOfThreePlanes) { ExpectLaw(Corners(14), kSamples); }
TEST(Promise1ExactLaw, HoldsInTriangleSoup) { ExpectLaw(Soup(9), kSoupSamples); }

// The largest moment score.
double WorstScore(const LawTable& table) {
  double worst = 0;
  for (const double score : table.Scores()) worst = std::max(worst, std::fabs(score));
  return worst;
}

// The tests above would notice: samples of a slightly wrong lambda fail them by far.
TEST(Promise1ExactLaw, ChecksRejectSamplesOfANeighbouringLambda) {
  for (const LawCase& c : {PlaneThroughCentres(200), ObliquePlane(150), Corners(14), Soup(9)}) {
    for (const double lambda : {2.0, 5.0, 20.0, 60.0}) {
      const LawTable table = DrawUntil(c, lambda * 1.1, lambda, 200'000);
      EXPECT_GT(WorstScore(table), kMostSigma) << c.name << ", lambda " << lambda;
    }
    EXPECT_GT(WorstScore(DrawUntil(c, 0.2, 0, 200'000)), kMostSigma)
        << c.name << ", lambda 0.2 taken for 0";
  }
  const ChiSquare fit = DrawUntil(PlaneThroughCentres(200), 5.3, 5, kSamples).Test();
  EXPECT_LT(fit.p_value(), kLeastP) << "lambda 5.3 taken for 5";
}

// They also notice one triangle of a cell missing in one copy of eight.
TEST(Promise1ExactLaw, ChecksRejectASurfaceWithAHole) {
  LawCase holed = Soup(9);
  std::size_t largest = 0;
  for (std::size_t i = 0; i < holed.model.size(); ++i) {
    if (AreaOfPolygon(ToLong(holed.model[i])) > AreaOfPolygon(ToLong(holed.model[largest]))) {
      largest = i;
    }
  }
  for (std::size_t i = 0; i < holed.mesh.size(); i += holed.model.size() * 8) {
    holed.mesh[i + largest] = holed.mesh[i + (largest + 1) % holed.model.size()];
  }
  EXPECT_LT(DrawUntil(holed, 5, 5, kSoupSamples).Test().p_value(), kLeastP);
}

}  // namespace
}  // namespace strata::test
