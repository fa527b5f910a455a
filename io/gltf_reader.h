// Reading glTF 2.0.
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens a .gltf or .glb as a MeshReader whose triangles come in the order of the meshes, of their
/// primitives, and of the nodes that place them. Each primitive is loaded once a pass, whatever the
/// number of its instances; what a file compressed is decoded a primitive at a time. There is no
/// vertex list: vertices() is empty. docs/mesh-formats.md says what is read.
/// Errors: those of OpenMesh.
Result<std::unique_ptr<MeshReader>> OpenGltf(std::unique_ptr<ByteSource> source,
                                             const OpenOptions& options);

}  // namespace strata::io
