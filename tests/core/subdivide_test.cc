// How far the paper's subdivision is from the law: measured, and held to what docs/adr/0002 states.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "tests/core/law_cases.h"

namespace strata::test {
namespace {

constexpr std::uint64_t kSamples = 30'000;

// The root mean square of the relative error of the density, over bins of a sixth of an edge: what
// chi-square has beyond its degrees of freedom, per sample.
double RelativeError(const LawCase& law_case, double lambda, Integrator integrator) {
  const LawTable table = DrawUntil(law_case, lambda, lambda, kSamples, integrator);
  const ChiSquare fit = table.Test();
  const double error = std::sqrt(
      std::max(0.0, (fit.statistic - fit.freedom) / static_cast<double>(table.samples())));
  std::printf("%s, lambda %g: relative error of the density %.3f, %llu of %llu outside\n",
              law_case.name.c_str(), lambda, error,
              static_cast<unsigned long long>(table.strangers()),
              static_cast<unsigned long long>(table.samples()));
  return error;
}

struct Stated {
  double lambda, error;
};

void ExpectStatedError(const LawCase& law_case, std::initializer_list<Stated> stated) {
  for (const Stated& s : stated) {
    EXPECT_LT(RelativeError(law_case, s.lambda, Integrator::kSubdivide), s.error)
        << law_case.name << ", lambda " << s.lambda;
    EXPECT_LT(RelativeError(law_case, s.lambda, Integrator::kExact), 0.05) << "the yardstick";
  }
}

TEST(Subdivide, IsOffTheLawOnAPlaneThroughTheCentresByWhatIsStated) {
  ExpectStatedError(PlaneThroughCentres(16), {{0, 0.5}, {5, 0.2}, {60, 1.5}});
}

}  // namespace
}  // namespace strata::test
