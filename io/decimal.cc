#include "io/decimal.h"

#include <fast_float/fast_float.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace strata::io {
namespace {

__extension__ using Wide = unsigned __int128;

// Powers of ten that are doubles, so that one rounded operation gives the nearest double.
constexpr double kPowers[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                              1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                              1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
constexpr int kMaxPower = 22;
constexpr int kFloatDigits = 9;
constexpr int kSafeDigits = 19;  // Always fit 64 bits.

// A decimal without its sign: digits * 10^exponent.
struct Decimal {
  const char* first;  // The text, without sign.
  const char* last;
  std::uint64_t digits = 0;  // Meaningless above kSafeDigits significant digits.
  int significant = 0;
  int exponent = 0;
};

bool IsDigit(char c) { return c >= '0' && c <= '9'; }
char Lower(char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + ('a' - 'A')) : c; }

// Takes digits from `p` on into `number`; returns where they end.
const char* TakeDigits(const char* p, const char* last, Decimal& number) {
  if (number.significant == 0) {
    while (p < last && *p == '0') ++p;
  }
  const char* const start = p;
  std::uint64_t digits = number.digits;
  for (; p < last && IsDigit(*p); ++p) digits = digits * 10 + static_cast<std::uint64_t>(*p - '0');
  number.digits = digits;
  // Above kSafeDigits the count only has to be large.
  number.significant += static_cast<int>(std::min<std::ptrdiff_t>(p - start, 1000));
  return p;
}

// The exponent part at `p`, if one stands there.
const char* TakeExponent(const char* p, const char* last, Decimal& number) {
  if (p >= last || Lower(*p) != 'e') return p;
  const char* q = p + 1;
  const bool negative = q < last && *q == '-';
  if (q < last && (*q == '-' || *q == '+')) ++q;
  if (q >= last || !IsDigit(*q)) return p;
  int exponent = 0;
  for (; q < last && IsDigit(*q); ++q) exponent = std::min(exponent * 10 + (*q - '0'), 100000);
  number.exponent += negative ? -exponent : exponent;
  return q;
}

// Splits the text into digits and exponent. Null if it is not a decimal.
const char* Scan(const char* first, const char* last, Decimal& number) {
  const char* p = TakeDigits(first, last, number);
  std::ptrdiff_t digits = p - first;
  if (p < last && *p == '.') {
    const char* fraction = p + 1;
    p = TakeDigits(fraction, last, number);
    digits += p - fraction;
    number.exponent = -static_cast<int>(std::min<std::ptrdiff_t>(p - fraction, 1 << 24));
  }
  if (digits == 0) return nullptr;
  p = TakeExponent(p, last, number);
  number.first = first;
  number.last = p;
  return p;
}

double NearestDouble(const Decimal& number) {
  if (number.significant == 0) return 0;
  if (number.significant <= kSafeDigits && number.digits < (std::uint64_t{1} << 53) &&
      number.exponent >= -kMaxPower && number.exponent <= kMaxPower) {
    const auto digits = static_cast<double>(number.digits);
    return number.exponent < 0 ? digits / kPowers[-number.exponent]
                               : digits * kPowers[number.exponent];
  }
  double value = 0;
  fast_float::from_chars(number.first, number.last, value);
  return value;
}

// The float nearest to the decimal whose nearest double is `value`. Rounding twice goes wrong only
// where the first rounding ended half way between two floats.
float NearestFloat(const Decimal& number, double value) {
  constexpr std::uint64_t kLow = (std::uint64_t{1} << 29) - 1, kHalf = std::uint64_t{1} << 28;
  const bool normal = value >= std::numeric_limits<float>::min();
  if (normal && (std::bit_cast<std::uint64_t>(value) & kLow) != kHalf) {
    return static_cast<float>(value);
  }
  float nearest = 0;
  fast_float::from_chars(number.first, number.last, nearest);
  return nearest;
}

// Whether `nearest` printed with as many digits as the decimal has gives the decimal.
bool PrintsAs(const Decimal& number, float nearest) {
  char text[64];
  const auto end = std::to_chars(text, text + sizeof text, nearest, std::chars_format::scientific,
                                 number.significant - 1);
  Decimal printed;
  return Scan(text, end.ptr, printed) != nullptr && printed.digits == number.digits &&
         printed.exponent == number.exponent;
}

// |decimal - nearest| <= half a unit of the decimal's last digit, exactly. With u = 10^-p that
// unit, nearest = m * 2^q, it says (2*digits - 1) * u <= 2 * nearest <= (2*digits + 1) * u.
bool WithinHalfUnit(const Decimal& number, float nearest) {
  constexpr int kMaxExact = 27;  // 10^27 * 2^25 is below 2^115.
  int q = 0;
  const auto m = static_cast<Wide>(std::ldexp(std::frexp(nearest, &q), 24));
  q -= 24;
  const int p = -number.exponent, shift = -(q + 1);
  // Beyond these nothing ends in exactly half a unit, and printing, which rounds such a half to
  // even, says the same.
  if (p < 0 || p > kMaxExact || shift < 0 || shift > 90) return PrintsAs(number, nearest);
  Wide scaled = m;
  for (int i = 0; i < p; ++i) scaled *= 10;
  const auto low = static_cast<Wide>(2 * number.digits - 1) << shift;
  const auto high = static_cast<Wide>(2 * number.digits + 1) << shift;
  return low <= scaled && scaled <= high;
}

double Round(const Decimal& number) {
  const double value = NearestDouble(number);
  if (number.significant == 0 || number.significant > kFloatDigits) return value;
  if (!(value <= std::numeric_limits<float>::max())) return value;
  const float nearest = NearestFloat(number, value);
  const double difference = std::fabs(value - static_cast<double>(nearest));
  if (difference == 0) return value;
  if (number.exponent < -kMaxPower || number.exponent > kMaxPower) {
    return PrintsAs(number, nearest) ? nearest : value;
  }
  const double unit =
      number.exponent < 0 ? 1 / kPowers[-number.exponent] : kPowers[number.exponent];
  // `value` is off by at most 2^-53 of itself, which only matters close to the boundary.
  const double slack = value * 0x1p-51;
  if (difference + slack < 0.5 * unit) return nearest;
  if (difference - slack > 0.5 * unit) return value;
  return WithinHalfUnit(number, nearest) ? nearest : value;
}

// Passes over `word`, given in small letters, or returns null.
const char* TakeWord(const char* p, const char* last, std::string_view word) {
  for (const char c : word) {
    if (p >= last || Lower(*p) != c) return nullptr;
    ++p;
  }
  return p;
}

// nan, inf and their relatives, at the first character after the sign.
const char* ParseSpecial(const char* p, const char* last, double& value) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr struct {
    std::string_view word;
    double value;
  } kWords[] = {{"infinity", kInf}, {"inf", kInf},     {"nan", kNan},    {"1.#inf", kInf},
                {"1.#ind", kNan},   {"1.#qnan", kNan}, {"1.#snan", kNan}};
  for (const auto& [word, number] : kWords) {
    const char* end = TakeWord(p, last, word);
    if (end == nullptr) continue;
    value = number;
    if (word == "nan" && end < last && *end == '(') {
      const char* close = std::find(end, last, ')');
      if (close < last) end = close + 1;
    }
    // Fixed-width printing pads 1.#INF with zeros.
    if (word.front() == '1') end = std::find_if_not(end, last, IsDigit);
    return end;
  }
  return nullptr;
}

}  // namespace

const char* ParseDecimal(const char* first, const char* last, double& value) {
  if (first >= last) return nullptr;
  const bool negative = *first == '-';
  if (negative || *first == '+') ++first;
  if (first >= last) return nullptr;
  Decimal number;
  const char* end = Scan(first, last, number);
  const bool windows = end != nullptr && end < last && *end == '#';
  if (end == nullptr || windows) {
    const char* special = ParseSpecial(first, last, value);
    if (special != nullptr) {
      if (negative) value = -value;
      return special;
    }
    if (end == nullptr) return nullptr;
  }
  const double magnitude = Round(number);
  value = negative ? -magnitude : magnitude;
  return end;
}

bool ParseWholeDecimal(std::string_view text, double& value) {
  const char* last = text.data() + text.size();
  return ParseDecimal(text.data(), last, value) == last && !text.empty();
}

}  // namespace strata::io
