// What the vertices of an OFF file carry: COFF, NOFF and STOFF.
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

/// What follows the coordinates on a vertex's line, in this order.
struct OffLayout {
  bool normal = false;       ///< Three numbers.
  int color = 0;             ///< Components: 0 = none, 3 or 4.
  bool color_bytes = false;  ///< 0 to 255; otherwise 0 to 1.
  bool uv = false;           ///< Two numbers.

  /// From the keyword's prefixes and what stands behind the coordinates of the first vertex: how
  /// many numbers a colour has, and whether they have a point, the file says nowhere else.
  static OffLayout Of(bool n, bool c, bool st, std::string_view behind_first);
  /// `color`, `vertex_normal`, `uv`, as far as they are there.
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
