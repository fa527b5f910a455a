// What a PLY file carries besides positions and faces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/byte_source.h"
#include "io/ply_header.h"
#include "io/ply_rows.h"

namespace strata::io {

/// Where things are in the file.
struct PlyPlaces {
  std::optional<std::size_t> vertices;  ///< The element of that name.
  PlyMark vertices_mark;                ///< Of its first row.
  std::size_t faces = 0;                ///< The first element of faces, or the elements' end.
  PlyMark faces_mark;                   ///< Of its first row.
};

/// One attribute of the file, and the properties that it is made of.
struct PlyAttribute {
  MeshAttribute what;
  bool of_faces = false;
  bool wedges = false;  ///< `property[0]` is a list that gives each corner a value.
  std::vector<std::size_t> property;
};

/// Whether the next function moves the source.
bool LooksAtRows(const PlyHeader& header, const PlyPlaces& places);

/// Every attribute, in the order of the header's properties. red, green, blue and alpha become
/// `color`; nx, ny, nz of vertices `vertex_normal`; u and v, s and t, texture_u and texture_v `uv`;
/// the faces' list texcoord a `uv` of the corners. Other numbers keep their names, and lists that
/// have 1 to kMostComponents items in the first row are vectors. Reads that row where there are
/// such lists, through a buffer of its own; where it cannot be read none of them is an attribute,
/// as what is wrong is for the faces' reader to say. Errors: kIo.
Result<std::vector<PlyAttribute>> FindPlyAttributes(ByteSource& source, const PlyHeader& header,
                                                    const PlyPlaces& places);

/// A pass that fetches `wanted`. What is referred to must outlive it, and nobody else may read from
/// `source` meanwhile. Vertices of fixed size are looked up in the file if it is a plain one;
/// others are read once and kept, beyond their part of the budget in scratch space.
Result<std::unique_ptr<AttributePass>> OpenPlyAttributes(
    ByteSource& source, const PlyHeader& header, const PlyPlaces& places,
    std::span<const PlyAttribute* const> wanted, RunContext& context);

}  // namespace strata::io
