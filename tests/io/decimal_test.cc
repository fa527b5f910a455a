#include "io/decimal.h"

#include <gtest/gtest.h>

#include <bit>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <string>

namespace strata::io {
namespace {

__extension__ using Wide = __int128;

constexpr double kInf = std::numeric_limits<double>::infinity();

double Parse(const std::string& text) {
  double value = 1234567;
  EXPECT_TRUE(ParseWholeDecimal(text, value)) << text;
  return value;
}

template <class... Args>
std::string Print(const char* format, Args... args) {
  char text[400];
  std::snprintf(text, sizeof text, format, args...);
  return text;
}

template <class T>
std::string Shortest(T value) {
  char text[64];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

float RandomFloat(std::mt19937_64& random) {
  for (;;) {
    const float value = std::bit_cast<float>(static_cast<std::uint32_t>(random()));
    if (std::isfinite(value)) return value;
  }
}

// A float of everyday size, among them many that lie half way between two short decimals.
float RandomTameFloat(std::mt19937_64& random) {
  const auto bits = static_cast<int>(random() % 24 + 1);
  const auto mantissa = static_cast<float>(random() % (1u << bits));
  const float value = std::ldexp(mantissa, -static_cast<int>(random() % 24));
  return random() % 2 == 0 ? value : -value;
}

TEST(ParseDecimal, GivesBackTheBitsOfAnyPrintedFloat) {
  std::mt19937_64 random(1);
  for (int i = 0; i < 300000; ++i) {
    const float value = i % 2 == 0 ? RandomFloat(random) : RandomTameFloat(random);
    for (const std::string& text :
         {Print("%.9g", value), Print("%.17g", value), Print("%.8e", value), Shortest(value)}) {
      const double parsed = Parse(text);
      ASSERT_EQ(std::bit_cast<std::uint64_t>(parsed), std::bit_cast<std::uint64_t>(double{value}))
          << text << " gave " << Print("%.17g", parsed);
    }
  }
}

TEST(ParseDecimal, GivesTheFloatForAnyRoundingOfItToAtMostNineDigits) {
  std::mt19937_64 random(2);
  int told_apart = 0;
  for (int i = 0; i < 200000; ++i) {
    const float value = i % 2 == 0 ? RandomFloat(random) : RandomTameFloat(random);
    const std::string text = Print("%.*e", static_cast<int>(random() % 9), value);
    const float nearest = std::strtof(text.c_str(), nullptr);
    if (nearest != value) continue;
    ++told_apart;
    ASSERT_EQ(Parse(text), double{value}) << text;
  }
  EXPECT_GT(told_apart, 20000);
}

TEST(ParseDecimal, GivesBackTheBitsOfAnyDoubleOfSeventeenDigits) {
  std::mt19937_64 random(3);
  for (int i = 0; i < 300000;) {
    const double value = std::bit_cast<double>(random());
    if (!std::isfinite(value)) continue;
    ++i;
    ASSERT_EQ(std::bit_cast<std::uint64_t>(Parse(Print("%.16e", value))),
              std::bit_cast<std::uint64_t>(value));
    const double tame = std::ldexp(double(random() >> 11), -30);
    ASSERT_EQ(Parse(Print("%.17g", tame)), tame);
  }
}

// The oracle works in integers: digits * 10^-places against m * 2^-s.
bool HalfUnitHolds(std::uint64_t digits, int places, double value) {
  int exponent = 0;
  const auto m = static_cast<Wide>(std::ldexp(std::frexp(value, &exponent), 53));
  const int shift = 53 - exponent;
  if (shift < 0 || shift > 90) return false;
  Wide left = m;
  for (int i = 0; i < places; ++i) left *= 10;
  const Wide right = static_cast<Wide>(digits) << shift;
  const Wide twice = 2 * (left > right ? left - right : right - left);
  return twice <= (static_cast<Wide>(1) << shift);
}

TEST(ParseDecimal, StaysWithinHalfAUnitOfTheLastDigit) {
  std::mt19937_64 random(4);
  int floats = 0, doubles = 0;
  for (int i = 0; i < 500000; ++i) {
    std::uint64_t power = 10;
    for (auto k = random() % 9; k > 0; --k) power *= 10;
    const std::uint64_t digits = random() % power;
    const int places = static_cast<int>(random() % 7);
    const std::uint64_t unit = static_cast<std::uint64_t>(std::pow(10, places) + 0.5);
    const std::string text = Print("%llu.%0*llu", static_cast<unsigned long long>(digits / unit),
                                   places, static_cast<unsigned long long>(digits % unit));
    if (digits == 0) continue;
    const double value = Parse(places == 0 ? std::to_string(digits) : text);
    ASSERT_TRUE(HalfUnitHolds(digits, places, value)) << text << " gave " << value;
    const bool is_float = static_cast<double>(static_cast<float>(value)) == value;
    ++(is_float ? floats : doubles);
    if (!is_float) {
      // Whatever is not a float is the nearest double, and no float would have done.
      const auto exact = static_cast<double>(digits) / static_cast<double>(unit);
      ASSERT_EQ(value, exact);
      const bool nine = digits < 1000000000;
      ASSERT_FALSE(nine && HalfUnitHolds(digits, places, std::strtof(text.c_str(), nullptr)))
          << text;
    }
  }
  EXPECT_GT(floats, 10000);
  EXPECT_GT(doubles, 10000);
}

TEST(ParseDecimal, TakesAFloatThatEndsInExactlyHalfAUnit) {
  // Printed with six places these round to even, down and up.
  EXPECT_EQ(Parse("843.179688"), 843.1796875);
  EXPECT_EQ(Parse("843.179687"), 843.1796875);
  EXPECT_EQ(Parse("843.148438"), 843.1484375);
  EXPECT_EQ(Parse("-843.148438"), -843.1484375);
  EXPECT_NE(Parse("843.148439"), 843.1484375);
}

TEST(ParseDecimal, KeepsDoublePrecisionWhereAFloatWouldNotDo) {
  EXPECT_EQ(Parse("364512.261"), 364512.261);
  EXPECT_EQ(Parse("5812345.12"), 5812345.12);
  EXPECT_EQ(Parse("16777217"), 16777217.0);
  EXPECT_EQ(Parse("0.1234567891"), 0.1234567891);
  EXPECT_EQ(Parse("1e-46"), 1e-46);
  EXPECT_EQ(Parse("1e39"), 1e39);
  EXPECT_EQ(Parse("0.1"), double{0.1f});
  EXPECT_EQ(Parse("0.1000000000"), 0.1);
}

TEST(ParseDecimal, AcceptsEveryUsualSpelling) {
  EXPECT_EQ(Parse("+1.5"), 1.5);
  EXPECT_EQ(Parse(".5"), 0.5);
  EXPECT_EQ(Parse("-.5"), -0.5);
  EXPECT_EQ(Parse("5."), 5);
  EXPECT_EQ(Parse("5.e1"), 50);
  EXPECT_EQ(Parse("1e+0005"), 100000);
  EXPECT_EQ(Parse("1E-00"), 1);
  EXPECT_EQ(Parse("25e-002"), 0.25);
  EXPECT_EQ(Parse("00012.50"), 12.5);
  EXPECT_EQ(Parse("0"), 0);
  EXPECT_TRUE(std::signbit(Parse("-0.000")));
  EXPECT_EQ(Parse("inf"), kInf);
  EXPECT_EQ(Parse("-INF"), -kInf);
  EXPECT_EQ(Parse("+Infinity"), kInf);
  EXPECT_EQ(Parse("1.#INF"), kInf);
  EXPECT_EQ(Parse("-1.#INF00"), -kInf);
  for (const char* nan : {"nan", "-NaN", "NAN", "nan(ind)", "-nan(ind)", "-1.#IND", "1.#QNAN00"}) {
    EXPECT_TRUE(std::isnan(Parse(nan))) << nan;
  }
}

TEST(ParseDecimal, GoesBeyondTheDoublesWithoutTrouble) {
  EXPECT_EQ(Parse("1e999"), kInf);
  EXPECT_EQ(Parse("-1e99999999999999999999"), -kInf);
  EXPECT_EQ(Parse("1e-99999999999999999999"), 0);
  EXPECT_EQ(Parse("1" + std::string(5000, '0')), kInf);
  EXPECT_EQ(Parse("1" + std::string(5000, '0') + "e-5000"), 1);
  EXPECT_EQ(Parse("0." + std::string(5000, '0') + "1e5001"), 1);
  EXPECT_EQ(Parse(std::string(5000, '0') + "7"), 7);
}

TEST(ParseDecimal, RefusesWhatIsNoNumber) {
  double value = 0;
  for (const char* text :
       {"",     "+",   "-",    ".",    "-.", "e5",  "x",   "--1",   "+-1", "n",  "na",  "i",
        "#INF", "1.#", "1.#X", "0x10", "1e", "1e+", "1,5", "1.5.5", "1 ",  " 1", "nan("}) {
    EXPECT_FALSE(ParseWholeDecimal(text, value)) << text;
  }
}

TEST(ParseDecimal, StopsBehindTheNumber) {
  const auto length = [](std::string_view text) {
    double value = 0;
    const char* end = ParseDecimal(text.data(), text.data() + text.size(), value);
    return end == nullptr ? -1 : static_cast<int>(end - text.data());
  };
  EXPECT_EQ(length("1.5 2"), 3);
  EXPECT_EQ(length("1e x"), 1);
  EXPECT_EQ(length("1e5x"), 3);
  EXPECT_EQ(length("0#red"), 1);
  EXPECT_EQ(length("x"), -1);
}

}  // namespace
}  // namespace strata::io
