#include "server/human_units.h"

#include <array>
#include <cmath>
#include <cstdio>

namespace strata::server {
namespace {

template <class... Values>
std::string Print(const char* format, Values... values) {
  std::array<char, 64> text;
  const int length = std::snprintf(text.data(), text.size(), format, values...);
  return std::string(text.data(), static_cast<std::size_t>(length));
}

}  // namespace

std::string Grouped(std::uint64_t n) {
  std::string text = std::to_string(n);
  for (std::size_t at = text.size(); at > 3;) text.insert(at -= 3, 1, ',');
  return text;
}

std::string Short(double value, int digits) { return Print("%.*g", digits, value); }

std::string Si(double value) {
  constexpr std::array<const char*, 5> kPrefixes = {"", "k", "M", "G", "T"};
  if (!std::isfinite(value)) value = 0;
  std::size_t prefix = 0;
  // 999.5 and above would print as 1000, or as 1e+03.
  for (; std::fabs(value) >= 999.5 && prefix + 1 < kPrefixes.size(); ++prefix) value /= 1000;
  const int decimals = std::fabs(value) < 9.995 ? 2 : std::fabs(value) < 99.95 ? 1 : 0;
  const bool whole = prefix == 0 && value == std::floor(value);
  return Print("%.*f ", whole ? 0 : decimals, value) + kPrefixes[prefix];
}

std::string Seconds(double seconds) {
  if (!(seconds >= 0)) seconds = 0;
  if (seconds < 9.995) return Print("%.2f s", seconds);
  if (seconds < 59.95) return Print("%.1f s", seconds);
  if (seconds > 1e9) return "over 30 years";
  const auto whole = static_cast<long>(std::lround(seconds));
  if (whole < 3600) return Print("%ld min %02ld s", whole / 60, whole % 60);
  return Print("%ld h %02ld min", whole / 3600, whole % 3600 / 60);
}

}  // namespace strata::server
