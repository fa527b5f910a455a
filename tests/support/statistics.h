// Tests of fit, with their p-values.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace strata::test {

/// The upper regularised incomplete gamma function Q(a, x), by series or continued fraction.
inline double UpperGamma(double a, double x) {
  if (x <= 0) return 1;
  const double scale = std::exp(a * std::log(x) - x - std::lgamma(a));
  if (x < a + 1) {
    double term = 1 / a, sum = term;
    for (int n = 1; n < 100000 && term > sum * 1e-17; ++n) sum += term *= x / (a + n);
    return 1 - scale * sum;
  }
  // The modified Lentz method.
  double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
  for (int n = 1; n < 100000; ++n) {
    const double k = -n * (n - a);
    b += 2;
    d = 1 / (k * d + b);
    c = b + k / c;
    const double factor = c * d;
    h *= factor;
    if (std::fabs(factor - 1) < 1e-15) break;
  }
  return scale * h;
}

/// A chi-square statistic that can be added up over independent tables.
struct ChiSquare {
  double statistic = 0;
  double freedom = 0;
  double samples = 0;
  double distance = 0;  ///< Sum over tables of samples · total variation distance.

  /// Probability of a statistic at least as large if the law holds.
  double p_value() const { return freedom > 0 ? UpperGamma(freedom / 2, statistic / 2) : 1; }
  /// Estimate of sum (q-p)^2/p, free of the bias that finite samples bring.
  double excess() const { return (statistic - freedom) / samples; }
  double total_variation() const { return distance / samples; }
  void Add(const ChiSquare& other) {
    statistic += other.statistic;
    freedom += other.freedom;
    samples += other.samples;
    distance += other.distance;
  }
};

/// Compares counts with probabilities (which add up to 1). Bins with fewer than ten expected
/// samples are taken together; a sample where none can be is an infinite statistic.
inline ChiSquare ChiSquareOf(const std::vector<std::uint64_t>& counts,
                             const std::vector<double>& probability) {
  double n = 0;
  for (const std::uint64_t c : counts) n += static_cast<double>(c);
  ChiSquare result;
  if (n == 0) return result;
  double rest_count = 0, rest_expected = 0, bins = 0, difference = 0;
  const auto add = [&](double count, double expected) {
    result.statistic += (count - expected) * (count - expected) / expected;
    difference += std::fabs(count - expected);
    ++bins;
  };
  for (std::size_t i = 0; i < counts.size(); ++i) {
    const double count = static_cast<double>(counts[i]), expected = n * probability[i];
    if (expected >= 10) {
      add(count, expected);
    } else {
      rest_count += count;
      rest_expected += expected;
    }
  }
  if (rest_expected > 1e-9 * n || rest_count > 0) add(rest_count, std::max(rest_expected, 1e-12));
  result.freedom = bins - 1;
  result.samples = n;
  result.distance = 0.5 * difference;
  if (result.freedom <= 0) result.statistic = result.freedom = 0;
  return result;
}

/// The p-value of the Kolmogorov-Smirnov test of `values` against the uniform law on [0,1].
inline double UniformKsPValue(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const double n = static_cast<double>(values.size());
  double d = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double at = static_cast<double>(i);
    d = std::max({d, values[i] - at / n, (at + 1) / n - values[i]});
  }
  const double t = d * (std::sqrt(n) + 0.12 + 0.11 / std::sqrt(n));
  double p = 0;
  for (int k = 1; k < 100; ++k) p += (k % 2 ? 2 : -2) * std::exp(-2.0 * k * k * t * t);
  return std::clamp(p, 0.0, 1.0);
}

}  // namespace strata::test
