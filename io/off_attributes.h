// What the vertices of an OFF file carry (COFF, NOFF and STOFF), and the colours of its faces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/byte_source.h"

namespace strata::io {

/// Numbers that are a colour.
struct OffColor {
  int components = 0;  ///< 0 = none, 3 or 4.
  bool bytes = false;  ///< 0 to 255; otherwise 0 to 1.
};

/// What follows the coordinates on a vertex's line, in this order, and the corners on a face's.
struct OffLayout {
  bool normal = false;  ///< Three numbers.
  OffColor color;
  bool uv = false;  ///< Two numbers.
  OffColor face_color;
  bool face_index = false;  ///< One whole number instead: a place in a colour map of the viewer's.

  /// From the keyword's prefixes and what stands behind the coordinates of the first vertex: how
  /// many numbers a colour has, and whether they have a point, the file says nowhere else.
  static OffLayout Of(bool n, bool c, bool st, std::string_view behind_first);
  /// Adds what the first face's line tells, for all of them.
  void AddFaces(std::string_view first);
  /// `color`, `vertex_normal`, `uv`, `face_color` (`color` where vertices have none) and
  /// `color_index`, as far as they are there. A face without a colour has zeros, or NaN.
  std::vector<MeshAttribute> Attributes() const;
};

/// Where things are in the file.
struct OffPlaces {
  std::int64_t vertices = 0, faces = 0;
  std::uint64_t vertices_offset = 0, vertices_line = 1, faces_offset = 0, faces_line = 1;
};

/// A pass that fetches `wanted` of what Attributes() gave. What is referred to must outlive it, and
/// nobody else may read from `source` meanwhile.
Result<std::unique_ptr<AttributePass>> OpenOffAttributes(
    ByteSource& source, std::size_t max_line_bytes, const OffLayout& layout,
    const OffPlaces& places, std::span<const MeshAttribute> wanted, RunContext& context);

}  // namespace strata::io
