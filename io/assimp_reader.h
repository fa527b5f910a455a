// Meshes that another process reads.
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Has OpenOptions::assimp, the program strata-assimp, read what `source` holds, and takes the
/// polygons from its pipe as they come. The child is on its own: no network, no files but the one
/// it is given, limits on memory (half of what is left of the account, 8 GiB at most) and
/// processor time. If it dies, that is kCorruptInput and says how. Rewind starts another.
/// Errors: those of OpenMesh.
Result<std::unique_ptr<MeshReader>> OpenAssimp(std::unique_ptr<ByteSource> source,
                                               const OpenOptions& options);

}  // namespace strata::io
