#include "io/srgb.h"

#include <array>
#include <cstddef>
#include <vector>

#include "core/numeric.h"

namespace strata::io {
namespace {

constexpr std::size_t kSteps = 1024;

// Where one code ends and the next begins, and the code at each of kSteps places to start from.
struct Codes {
  std::array<double, 255> end;  // Of code k: the light half way, as encoded, to code k + 1.
  std::array<std::uint8_t, kSteps + 1> first;
};

Codes MakeCodes() {
  Codes codes;
  for (std::size_t k = 0; k < codes.end.size(); ++k) {
    codes.end[k] = LinearOfSrgb((static_cast<double>(k) + 0.5) / 255);
  }
  std::size_t code = 0;
  for (std::size_t step = 0; step <= kSteps; ++step) {
    while (code < 255 && static_cast<double>(step) / kSteps >= codes.end[code]) ++code;
    codes.first[step] = static_cast<std::uint8_t>(code);
  }
  return codes;
}

std::vector<double> MakeLight(std::size_t values) {
  std::vector<double> light(values);
  for (std::size_t k = 0; k < values; ++k) {
    light[k] = LinearOfSrgb(static_cast<double>(k) / static_cast<double>(values - 1));
  }
  return light;
}

}  // namespace

// The C library's pow differs between processors.
double LinearOfSrgb(double encoded) {
  if (encoded <= 0.04045) return encoded / 12.92;
  return Exp(2.4 * Log((encoded + 0.055) / 1.055));
}

std::uint8_t Srgb8OfLinear(double linear) {
  static const Codes codes = MakeCodes();
  if (!(linear > 0)) return 0;
  if (linear >= 1) return 255;
  std::size_t code = codes.first[static_cast<std::size_t>(linear * kSteps)];
  while (code < 255 && linear >= codes.end[code]) ++code;
  return static_cast<std::uint8_t>(code);
}

const double* LinearOfSrgb8() {
  static const std::vector<double> light = MakeLight(256);
  return light.data();
}

const double* LinearOfSrgb16() {
  static const std::vector<double> light = MakeLight(65536);
  return light.data();
}

}  // namespace strata::io
