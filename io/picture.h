// A picture of samples.
#pragma once

#include <string>

#include "core/samples.h"

namespace strata::io {

/// How to look at the samples.
struct PictureOptions {
  double edge = 1;   ///< The cell's edge, world units, > 0: the discs' size follows from it.
  int width = 1024;  ///< Pixels, 16 to 4096.
  int height = 768;  ///< Pixels, 16 to 4096.
  int up_axis = 1;   ///< The axis that points up: 0 = x, 1 = y, 2 = z.
  /// With 0 and y up the viewer stands on the side of negative z; each turn, 0 to 3, takes the
  /// viewer a quarter further around the axis, counter-clockwise seen from above.
  int quarter_turns = 0;
};

/// Draws the samples as discs on the surface they suggest, seen from the front, a little from
/// above and from the right, framed to fill the picture, and writes a PNG, whole or not at all ("-"
/// is standard output). Discs lie along the normals and are shaded by them; without normals they
/// face the viewer and are shaded by depth.
///
/// The picture is a function of the arguments alone. Memory: 90 bytes a pixel. Threads: the
/// caller's. Errors: kEmptySurface (no samples), kInvalidArgument (options out of range), kInternal
/// (positions not finite, a normal column of another length), kOverBudget (memory), kIo.
Result<void> WritePicture(const std::string& path, const SampleColumns& samples,
                          const PictureOptions& options);

}  // namespace strata::io
