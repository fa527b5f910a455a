// Reading a decimal number whose precision the format does not declare.
#pragma once

#include <string_view>

namespace strata::io {

/// Reads the number at the start of [first, last) into `value` and returns where it ends; null if
/// no number stands there. What follows the number is the caller's to judge.
///
/// The rule for text formats that do not say in what precision they were written (OBJ, OFF): a
/// decimal of at most nine significant digits that is the rounding of its nearest float to that
/// many digits *is* that float, that is if |decimal - float| is at most half a unit of the last
/// digit; every other decimal is the nearest double. So
///  - a float printed with %.9g, or with as few digits as tell it from its neighbours, or as its
///    exact value, is read back as that very float, and a mesh of floats stays one of floats;
///  - a number that needs more, say the easting 364512.261, keeps double precision;
///  - the value never differs from what is written by more than half a unit of its last digit.
/// Digits are counted as written: leading zeros do not count, trailing ones do.
///
/// Accepts a sign, ".5", "5.", exponents of any length, and in any case nan, inf, infinity,
/// nan(…), and the spellings 1.#INF, 1.#IND, 1.#QNAN of old Windows libraries. Not hexadecimal.
/// A decimal beyond the doubles is infinite, one below them zero.
const char* ParseDecimal(const char* first, const char* last, double& value);

/// The same for a string that must be a number from end to end.
bool ParseWholeDecimal(std::string_view text, double& value);

}  // namespace strata::io
