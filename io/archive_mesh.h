// A mesh in a ZIP archive.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Opens what a member of an archive holds, with its companions.
using OpenMember = std::function<Result<std::unique_ptr<MeshReader>>(std::unique_ptr<ByteSource>,
                                                                     const OpenOptions&)>;

/// Opens the mesh in an archive: the member that OpenOptions::member names, else the only one whose
/// suffix is that of a mesh; or all of a 3MF package. Members are unpacked to scratch space.
/// Errors: those of ZipArchive and of `open`; kNotFound for a member that is not there;
/// kUnsupported, listing what there is, where no mesh is found or several are.
Result<std::unique_ptr<MeshReader>> OpenArchive(std::unique_ptr<ByteSource> source,
                                                const OpenOptions& options, const OpenMember& open);

}  // namespace strata::io
