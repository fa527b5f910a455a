#include "io/texture_sampler.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/numeric.h"
#include "io/srgb.h"

namespace strata::io {
namespace {

// A coordinate in pixels, within the first repetition or, mirrored, the first two.
double PixelsAlong(double coordinate, Wrap wrap, std::uint32_t size) {
  const double pixels = size;
  switch (wrap) {
    case Wrap::kRepeat:
      return (coordinate - std::floor(coordinate)) * pixels;
    case Wrap::kMirror:
      return (coordinate - 2 * std::floor(coordinate / 2)) * pixels;
    case Wrap::kClamp:
      return std::clamp(coordinate, 0.0, 1.0) * pixels;
  }
  return 0;
}

// The pixel that stands at place `i`, which is a little outside of what PixelsAlong gives at most.
std::uint32_t PixelAt(std::int64_t i, Wrap wrap, std::uint32_t size) {
  const std::int64_t n = size;
  switch (wrap) {
    case Wrap::kRepeat:
      return static_cast<std::uint32_t>((i + n) % n);
    case Wrap::kMirror: {
      const std::int64_t k = (i + 2 * n) % (2 * n);
      return static_cast<std::uint32_t>(k < n ? k : 2 * n - 1 - k);
    }
    case Wrap::kClamp:
      return static_cast<std::uint32_t>(std::clamp<std::int64_t>(i, 0, n - 1));
  }
  return 0;
}

Rgba Light(const Image& image, std::uint32_t x, std::uint32_t y) {
  const unsigned char* const pixel = image.At(x, y);
  if (image.head().channel_bytes() == 1) {
    const double* const light = LinearOfSrgb8();
    return {light[pixel[0]], light[pixel[1]], light[pixel[2]], pixel[3] / 255.0};
  }
  std::uint16_t wide[4];
  std::memcpy(wide, pixel, sizeof wide);
  const double* const light = LinearOfSrgb16();
  return {light[wide[0]], light[wide[1]], light[wide[2]], wide[3] / 65535.0};
}

Rgba Mix(const Rgba& a, const Rgba& b, double t) {
  Rgba mixed;
  for (std::size_t k = 0; k < 4; ++k) mixed[k] = a[k] + (b[k] - a[k]) * t;
  return mixed;
}

}  // namespace

UvTransform UvTransform::FromTrs(std::array<double, 2> offset, double radians,
                                 std::array<double, 2> scale) {
  const double turns = radians / (2 * kPi);
  const auto [s, c] = SinCosOfTurns(std::isfinite(turns) ? turns - std::floor(turns) : 0);
  return {{c * scale[0], s * scale[1], offset[0], -s * scale[0], c * scale[1], offset[1]}};
}

Rgba LookUp(const Image& image, const TextureSampler& sampler, double u, double v) {
  const double x = PixelsAlong(u, sampler.u, image.width());
  const double y = PixelsAlong(v, sampler.v, image.height());
  const auto light = [&](std::int64_t i, std::int64_t j) {
    return Light(image, PixelAt(i, sampler.u, image.width()),
                 PixelAt(j, sampler.v, image.height()));
  };
  if (sampler.nearest) {
    return light(static_cast<std::int64_t>(std::floor(x)),
                 static_cast<std::int64_t>(std::floor(y)));
  }
  // Pixels' colours are those of their middles.
  const double left = std::floor(x - 0.5), top = std::floor(y - 0.5);
  const double along = x - 0.5 - left, down = y - 0.5 - top;
  const auto i = static_cast<std::int64_t>(left), j = static_cast<std::int64_t>(top);
  return Mix(Mix(light(i, j), light(i + 1, j), along),
             Mix(light(i, j + 1), light(i + 1, j + 1), along), down);
}

}  // namespace strata::io
