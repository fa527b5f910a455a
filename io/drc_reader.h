// Reading Draco meshes (.drc).
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens a Draco mesh. Draco cannot be read in parts: the faces stay in memory, and decoding needs
/// what DracoDecodeBytes says, which is taken from the account before it begins; fetching
/// attributes decodes again. Errors: those of OpenMesh; kUnsupported for point clouds.
Result<std::unique_ptr<MeshReader>> OpenDraco(std::unique_ptr<ByteSource> source,
                                              const OpenOptions& options);

}  // namespace strata::io
