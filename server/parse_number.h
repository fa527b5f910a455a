// Numbers as options take them: in range, or an error that says what the range is.
#pragma once

#include <charconv>
#include <cmath>
#include <string>
#include <string_view>
#include <type_traits>

#include "core/result.h"

namespace strata::server {

/// What an option accepts.
template <class T>
struct NumberRange {
  const char* option;    ///< "--lambda".
  T min, max;            ///< Both included.
  const char* expected;  ///< For the message: "a number from 0 to 500 (default 5)".
};

/// The whole of `text` as a T within `range`; no sign but '-', no space, no suffix, no NaN or
/// infinity. Errors: kInvalidArgument: option, found, expected.
template <class T>
Result<T> ParseNumber(std::string_view text, const NumberRange<T>& range) {
  T value{};
  const char* const end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, value);
  bool good = parsed.ec == std::errc{} && parsed.ptr == end;
  if constexpr (std::is_floating_point_v<T>) good = good && std::isfinite(value);
  if (good && value >= range.min && value <= range.max) return value;
  return Fail(ErrorCode::kInvalidArgument, std::string(range.option) + ": found '" +
                                               std::string(text) + "', expected " + range.expected);
}

}  // namespace strata::server
