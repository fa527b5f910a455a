// Cutting a polygon into triangles.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/vec3.h"

namespace strata::io {

/// Appends exactly n-2 triangles that cut up the polygon of the n `corners`, as indices into
/// `corners`, turning the way the polygon turns; appends nothing if n < 3.
///
/// A simple polygon, convex or concave, is covered once, and its triangles all have positive area
/// if no two neighbouring corners coincide. Holes joined to the outline by a bridge of two
/// coincident edges work too. The polygon is seen along the axis closest to its normal (Newell's),
/// so it need not be quite flat. Polygons that cross themselves, fold back or have no area still
/// give n-2 triangles; which ones is fixed but not otherwise specified.
///
/// A pure function in plain IEEE operations. As long as all corners are finite, the set of
/// triangles does not depend on which corner comes first: work starts at the corner from which the
/// sequence of coordinates is lexicographically smallest. Quads that are convex are cut along the
/// shorter diagonal. A polygon with a non-finite corner becomes a fan around corner 0.
///
/// Time: n log n in practice and bounded by some 1000 operations per corner whatever the input.
/// Should a hostile polygon of thousands of corners exhaust that, the rest of it becomes a fan.
/// Memory: about 60 bytes per corner, from the stack for small polygons. n must be below 2^31.
void TriangulatePolygon(std::span<const Vec3> corners,
                        std::vector<std::array<std::uint32_t, 3>>& out);

}  // namespace strata::io
