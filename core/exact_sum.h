// Sums of floating-point numbers that do not depend on their order.
#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace strata {

/// The sum of non-negative finite doubles, kept exactly: one counter of 128 bits for each exponent.
/// Up to 2^75 numbers. 32 KB.
class ExactSum {
 public:
  /// Precondition: 0 <= x < infinity.
  void Add(double x) {
    const auto bits = std::bit_cast<std::uint64_t>(x);
    const std::uint64_t exponent = bits >> kMantissa, fraction = bits & (kOne - 1);
    AddTo(exponent, {exponent == 0 ? fraction : fraction | kOne, 0});
  }
  void Add(const ExactSum& other) {
    for (std::size_t e = 0; e < counters_.size(); ++e) AddTo(e, other.counters_[e]);
  }
  /// The same bits for the same numbers in any order; within 2^-50 of the sum, relative to it.
  double value() const {
    double sum = 0;
    for (std::size_t e = 0; e < counters_.size(); ++e) {
      const Counter& c = counters_[e];
      if (c.low == 0 && c.high == 0) continue;
      const double units = static_cast<double>(c.high) * 0x1p64 + static_cast<double>(c.low);
      sum += std::ldexp(units, static_cast<int>(e == 0 ? 1 : e) - kUnitExponent);
    }
    return sum;
  }

 private:
  static constexpr int kMantissa = 52, kUnitExponent = 1023 + kMantissa;
  static constexpr std::uint64_t kOne = std::uint64_t{1} << kMantissa;
  struct Counter {
    std::uint64_t low = 0, high = 0;
  };

  void AddTo(std::size_t exponent, const Counter& more) {
    Counter& c = counters_[exponent];
    c.low += more.low;
    c.high += more.high + (c.low < more.low ? 1 : 0);
  }

  std::array<Counter, 2047> counters_;  // By the exponent's bits.
};

}  // namespace strata
