// The parts of a 3MF package: objects and where they are placed.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/memory_account.h"
#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/affine.h"
#include "io/open_mesh.h"
#include "io/vertex_array.h"
#include "io/vertex_store.h"
#include "io/zip_archive.h"

namespace strata::io {

/// What a triangle or object says of its properties: a group of resources and an entry of it for
/// each corner. Without a first entry it says nothing, and the object's counts; without a group the
/// object's group does.
struct ThreeMfProperty {
  static constexpr std::uint32_t kNone = UINT32_MAX;
  std::uint32_t group = kNone;  ///< The file's number of it.
  std::array<std::uint32_t, 3> entry = {kNone, kNone, kNone};
};

/// A mesh object's data. Memory: the vertices (beyond the budget in scratch space) and 12 bytes a
/// triangle, 28 where one of them has properties of its own, taken from the account.
struct ThreeMfMesh {
  ThreeMfMesh(const std::string& name, const OpenOptions& options) : vertices(name, options) {}
  VertexStore vertices;
  GrowArray<std::uint32_t> corners;
  GrowArray<ThreeMfProperty> properties;  ///< Of each triangle; empty if none has its own.
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
  std::string name;
  ThreeMfProperty property;  ///< Of triangles that say nothing.
};

/// A group of properties: base materials, colours, or layers of others.
struct ThreeMfGroup {
  enum class Kind : std::uint8_t { kMaterials, kColors, kLayers };
  using Color = std::array<std::uint8_t, 4>;  ///< sRGB and alpha.

  Kind kind = Kind::kMaterials;
  std::uint32_t first_material = 0;    ///< Of entry 0, in ThreeMfModel::materials.
  std::vector<Color> colors;           ///< Of each entry; of base materials as displayed.
  std::vector<std::uint32_t> layers;   ///< The groups' numbers.
  std::vector<std::uint32_t> entries;  ///< One for each layer, entry after entry.
};

struct ThreeMfModel {
  /// By member of the archive and id.
  std::map<std::pair<std::string, std::uint64_t>, ThreeMfObject> objects;
  std::vector<ThreeMfObject::Component> items;  ///< Of the build.
  std::string unit = "millimeter";              ///< As the file says it.
  std::vector<std::string> materials;           ///< Names of all base materials.
  /// Property groups by member of the archive and number.
  std::map<std::pair<std::string, std::uint32_t>, ThreeMfGroup> groups;
  std::vector<std::string> item_names;  ///< Of the items: their part numbers.
  bool has_colors = false;
  std::uint64_t other_groups = 0;  ///< Of textures, composites and what else there is.
  std::vector<MemoryShare> shares;
};

/// Reads the root model and the model parts that its components name. Everything is looked for
/// inside the archive alone. Errors: kCorruptInput (member, line), kUnsupported (a required
/// extension that is not read), kOverBudget, kIo.
Result<ThreeMfModel> ReadThreeMf(ZipArchive& archive, const OpenOptions& options);

}  // namespace strata::io
