// Elementary functions in plain IEEE operations.
//
// The C library picks variants of exp and log by processor (with and without fused multiply-add),
// so their last bit is not the same everywhere. Whatever decides a sample uses these instead:
// compiled with -ffp-contract=off they give the same bits on every processor and compiler. Errors
// are a few units in the last place, which no test of the law can see. Pure; any thread.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

namespace strata {

inline constexpr double kPi = 3.14159265358979323846;

/// The nearest integer of a number of magnitude below 2^51, ties to even. Adding a large number
/// leaves no room for a fraction; unlike std::floor it is never a call.
inline double RoundToInteger(double x) { return (x + 0x1.8p52) - 0x1.8p52; }

/// The largest integer not above x. Precondition: |x| < 2^31.
inline std::int32_t FloorToInt(double x) {
  const auto i = static_cast<std::int32_t>(x);
  return i - (x < i);
}
/// The smallest integer not below x. Precondition: |x| < 2^31.
inline std::int32_t CeilToInt(double x) {
  const auto i = static_cast<std::int32_t>(x);
  return i + (x > i);
}

/// 2^k for -1022 <= k <= 1023.
inline double PowerOfTwo(int k) {
  return std::bit_cast<double>(static_cast<std::uint64_t>(k + 1023) << 52);
}

/// e^x for -700 <= x <= 700; 0 below. Reduction to |r| <= ln(2)/2, Taylor series to degree 13.
inline double Exp(double x) {
  if (x < -700) return 0;
  const double k = RoundToInteger(x * 1.44269504088896340736);
  const double r = (x - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
  const double r2 = r * r, r4 = r2 * r2, r8 = r4 * r4;
  const double a = (1 + r) + r2 * (1.0 / 2 + r * (1.0 / 6));
  const double b = (1.0 / 24 + r * (1.0 / 120)) + r2 * (1.0 / 720 + r * (1.0 / 5040));
  const double c = (1.0 / 40320 + r * (1.0 / 362880)) + r2 * (1.0 / 3628800 + r * (1.0 / 39916800));
  const double d = 1.0 / 479001600 + r * (1.0 / 6227020800);
  return (a + r4 * b + r8 * (c + r4 * d)) * PowerOfTwo(static_cast<int>(k));
}

/// Natural logarithm of a positive, normal, finite number, by the series of atanh.
inline double Log(double x) {
  const auto bits = std::bit_cast<std::uint64_t>(x);
  int exponent = static_cast<int>(bits >> 52) - 1023;
  double m = std::bit_cast<double>((bits & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
  if (m > 1.41421356237309504880) m *= 0.5, ++exponent;
  const double s = (m - 1) / (m + 1), z = s * s, z2 = z * z, z4 = z2 * z2;
  const double a = (1.0 / 3 + z * (1.0 / 5)) + z2 * (1.0 / 7 + z * (1.0 / 9));
  const double b = (1.0 / 11 + z * (1.0 / 13)) + z2 * (1.0 / 15 + z * (1.0 / 17));
  const double c = 1.0 / 19 + z * (1.0 / 21);
  const double series = 2 * s + 2 * s * z * (a + z4 * (b + z4 * c));
  return exponent * 6.93147180369123816490e-01 + (series + exponent * 1.90821492927058770002e-10);
}

/// -ln(1 - v) for v a multiple of 2^-53 in [0,1): then 1 - v is exact, and so is the result's
/// relative accuracy for small v.
inline double NegLogOneMinus(double v) { return -Log(1 - v); }

struct SinCos {
  double sin, cos;
};

/// Sine and cosine of `turns` full turns, 0 <= turns <= 1.
inline SinCos SinCosOfTurns(double turns) {
  const double quadrant = RoundToInteger(turns * 4);
  const double x = (turns - quadrant * 0.25) * (2 * kPi), z = x * x;
  const double s_rest = 1 - z / 110 * (1 - z / 156 * (1 - z / 210));
  const double s = x * (1 - z / 6 * (1 - z / 20 * (1 - z / 42 * (1 - z / 72 * s_rest))));
  const double c_rest = 1 - z / 90 * (1 - z / 132 * (1 - z / 182 * (1 - z / 240)));
  const double c = 1 - z / 2 * (1 - z / 12 * (1 - z / 30 * (1 - z / 56 * c_rest)));
  switch (static_cast<int>(quadrant) & 3) {
    case 0:
      return {s, c};
    case 1:
      return {c, -s};
    case 2:
      return {-s, -c};
    default:
      return {-c, s};
  }
}

}  // namespace strata
