// Reading an integer from a text line.
#pragma once

#include <cstdint>

namespace strata::io {

inline bool IsDigit(char c) { return c >= '0' && c <= '9'; }

/// Reads the integer, with or without sign, at the start of [first, last) into `value`, and returns
/// where it ends; null if none stands there. What does not fit 62 bits becomes the largest or
/// smallest value that does, which as an index is out of range as well.
inline const char* ParseIndex(const char* first, const char* last, std::int64_t& value) {
  constexpr std::int64_t kLimit = std::int64_t{1} << 62;
  const char* p = first;
  const bool negative = p < last && *p == '-';
  if (p < last && (*p == '-' || *p == '+')) ++p;
  const char* const digits = p;
  std::int64_t magnitude = 0;
  for (; p < last && IsDigit(*p); ++p) {
    magnitude = magnitude >= kLimit / 10 ? kLimit : magnitude * 10 + (*p - '0');
  }
  if (p == digits) return nullptr;
  value = negative ? -magnitude : magnitude;
  return p;
}

}  // namespace strata::io
