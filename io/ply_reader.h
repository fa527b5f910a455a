// Reading PLY (Stanford polygon) files.
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens a PLY file whose first byte is `source`'s first, and reads its vertices.
///
/// Ascii and binary of both endians; properties in any order and of any type, lists included;
/// elements in any order, unknown ones passed over. Surfaces are the elements `face`, polygons as a
/// list `vertex_indices` or `vertex_index`, and `tristrips`, the same list with -1 between strips;
/// they are read in file order and numbered through. x, y and z stay single precision where their
/// types allow. Without a surface element the mesh is empty, which is no error.
///
/// Whatever follows the last row must be white space or zeros, which is what writers pad with: more
/// data than the header declares contradicts it as much as less. Ascii data: one row a line, blank
/// lines do not count, values of other properties are not looked at.
/// Errors: kCorruptInput, kUnsupported, kIo, kOverBudget (the vertices do not fit into memory).
Result<std::unique_ptr<MeshReader>> OpenPly(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options);

}  // namespace strata::io
