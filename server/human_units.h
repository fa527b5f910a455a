// Numbers as people read them.
#pragma once

#include <cstdint>
#include <string>

namespace strata::server {

/// 1234567 → "1,234,567".
std::string Grouped(std::uint64_t n);
/// `digits` (1 to 17) significant digits, no trailing zeros.
std::string Short(double value, int digits = 6);
/// Three significant digits and a decimal prefix with a space before it: 1234567 → "1.23 M",
/// so that a unit can follow. 0 for what is not finite.
std::string Si(double value);
/// "0.42 s", "12.3 s", "3 min 05 s", "2 h 07 min".
std::string Seconds(double seconds);

}  // namespace strata::server
