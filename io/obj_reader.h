// Reading Wavefront OBJ files.
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens an OBJ file whose first byte is `source`'s first, and reads its vertices: a first pass
/// over the whole text. Faces are read by a second pass, over the part of the text that has any.
///
/// Used are the vertices `v x y z`, whatever follows the three (a weight, a colour), and the faces
/// `f` (and `fo`, their old name) with corners v, v/vt, v//vn or v/vt/vn, of which only v matters.
/// Indices count from 1, or backwards from the last vertex before the line if negative; a face may
/// come before its vertices. A backslash at its end joins a line to the next one; in a comment it
/// does not. `#` ends a line anywhere in these two statements. All other statements are passed over
/// (free-form curves and surfaces, points and lines among them), and no other file is opened.
///
/// Coordinates are read by the rule of io/decimal.h; nan and inf are numbers.
/// A face with fewer than three corners, or one with an index of 0 or beyond the vertices, is
/// skipped and counted. Errors: kCorruptInput for a vertex of fewer than three numbers, a corner
/// that is not an integer, an overlong line, or a text that ends within a vertex or a face; kIo;
/// kOverBudget (the vertices do not fit into memory).
Result<std::unique_ptr<MeshReader>> OpenObj(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options);

}  // namespace strata::io
