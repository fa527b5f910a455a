// Reading the OFF family of files (Geomview's object file format).
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens an OFF file whose first byte is `source`'s first, and reads its vertices.
///
/// The text is a keyword, the numbers of vertices, faces and (not needed, not looked at) edges, one
/// line per vertex and one per face. The keyword is OFF with any of the prefixes ST, C and N, or is
/// missing; the numbers may stand on its line, even without a blank between. Blank lines and
/// whatever follows a `#` do not count. A vertex's line starts with x, y, z, a face's with the
/// number of its corners and their indices from 0; colours, normals and all else that follows on
/// these lines is not looked at. A vertex or face may not go over several lines, nor share one.
/// Only blank lines and comments may follow the last face.
///
/// Coordinates are read by the rule of io/decimal.h; nan and inf are numbers. A face with fewer
/// than three corners or an index that no vertex has is skipped and counted. The number of edges
/// aside, the header's numbers must be right; nothing is allocated from them.
/// Errors: kUnsupported for four or n dimensions (4OFF, nOFF) and for OFF BINARY; kCorruptInput;
/// kIo; kOverBudget (the vertices do not fit into memory).
Result<std::unique_ptr<MeshReader>> OpenOff(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options);

}  // namespace strata::io
