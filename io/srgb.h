// Between what is encoded for display (sRGB) and light, the same on every processor.
#pragma once

#include <cstdint>

namespace strata::io {

/// Light, 0 to 1, of an encoded value, 0 to 1.
double LinearOfSrgb(double encoded);
/// The encoded value nearest to this light, which is clamped to [0, 1]: the k whose light
/// LinearOfSrgb(k / 255) comes back as k, and half way between two means half way as encoded.
std::uint8_t Srgb8OfLinear(double linear);

/// Light of each value of 8 bits: 256 numbers.
const double* LinearOfSrgb8();
/// Light of each value of 16 bits: 65,536 numbers, made when they are first asked for.
const double* LinearOfSrgb16();

}  // namespace strata::io
