// Reading 3MF.
#pragma once

#include <memory>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/open_mesh.h"
#include "io/zip_archive.h"

namespace strata::io {

/// Opens a 3MF package: the items of its build, their components placed by their transforms. The
/// unit is reported, nothing is scaled. Triangles come by object, then by placing. Errors: those of
/// ReadThreeMf; kCorruptInput for an object that is not there or is a component of itself.
Result<std::unique_ptr<MeshReader>> OpenThreeMf(std::shared_ptr<ZipArchive> archive,
                                                const OpenOptions& options);

}  // namespace strata::io
