// The parts of a 3MF package: objects and where they are placed.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/affine.h"
#include "io/open_mesh.h"
#include "io/vertex_array.h"
#include "io/vertex_store.h"
#include "io/zip_archive.h"

namespace strata::io {

/// A mesh object's data. Memory: the vertices (beyond the budget in scratch space) and 12 bytes a
/// triangle, taken from the account.
struct ThreeMfMesh {
  ThreeMfMesh(const std::string& name, const OpenOptions& options) : vertices(name, options) {}
  VertexStore vertices;
  GrowArray<std::uint32_t> corners;
  std::vector<MemoryShare> shares;
};

/// An object of a model part: a mesh, or others put together.
struct ThreeMfObject {
  std::shared_ptr<ThreeMfMesh> mesh;
  struct Component {
    std::string part;  ///< The archive's member.
    std::uint64_t object = 0;
    Affine transform;
  };
  std::vector<Component> components;
};

struct ThreeMfModel {
  /// By member of the archive and id.
  std::map<std::pair<std::string, std::uint64_t>, ThreeMfObject> objects;
  std::vector<ThreeMfObject::Component> items;  ///< Of the build.
  std::string unit = "millimeter";              ///< As the file says it.
  std::vector<std::string> materials;
};

/// Reads the root model and the model parts that its components name. Everything is looked for
/// inside the archive alone. Errors: kCorruptInput (member, line), kUnsupported (a required
/// extension that is not read), kOverBudget, kIo.
Result<ThreeMfModel> ReadThreeMf(ZipArchive& archive, const OpenOptions& options);

}  // namespace strata::io
