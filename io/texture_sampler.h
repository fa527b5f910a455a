// Looking a place of an image up, as renderers do.
#pragma once

#include <array>
#include <cstdint>

#include "io/image.h"

namespace strata::io {

/// What lies beside the image.
enum class Wrap : std::uint8_t {
  kRepeat,
  kMirror,  ///< Again and again, every second time mirrored.
  kClamp,   ///< The pixels of its edge.
};

struct TextureSampler {
  Wrap u = Wrap::kRepeat, v = Wrap::kRepeat;
  bool nearest = false;  ///< The pixel that the place lies in; else bilinear, between four.
};

/// An affine map of texture coordinates: (m[0] u + m[1] v + m[2], m[3] u + m[4] v + m[5]).
struct UvTransform {
  std::array<double, 6> m = {1, 0, 0, 0, 1, 0};

  /// First scaled, then turned by `radians` counter-clockwise where v points down (any finite
  /// angle; the same bits on every processor), then moved: KHR_texture_transform.
  static UvTransform FromTrs(std::array<double, 2> offset, double radians,
                             std::array<double, 2> scale);
};

/// Red, green and blue as light, and alpha; 0 to 1 each.
using Rgba = std::array<double, 4>;

/// The image at (u, v), finite: (0, 0) is the top left corner of its first pixel, (1, 1) the bottom
/// right one of its last. Colours are mixed as light, alpha on its own; the base level alone, as if
/// seen from near.
Rgba LookUp(const Image& image, const TextureSampler& sampler, double u, double v);

}  // namespace strata::io
