// What the triangles of a 3MF package carry.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/three_mf_package.h"

namespace strata::io {

/// An object with a mesh.
struct ThreeMfMeshObject {
  std::string part;  ///< The archive's member that defines it.
  std::uint64_t id = 0;
  const ThreeMfObject* object = nullptr;
};

/// `color` (of colour groups, or as base materials are displayed; sRGB with alpha), `material`
/// (names of base materials), `object` and `item` (of the build), as far as there are such things.
/// Names of objects are their own, else "object <id>"; of items their part numbers.
std::vector<MeshAttribute> ListThreeMfAttributes(const ThreeMfModel& model,
                                                 const std::vector<ThreeMfMeshObject>& objects);

/// A triangle's object, its number in the object's mesh, the item of the build that places it, and
/// whether the second and third corner have changed places.
struct ThreeMfPlace {
  std::size_t object = 0;
  std::uint64_t triangle = 0;
  std::uint32_t item = 0;
  bool mirrored = false;
};

/// Gives `wanted` of ListThreeMfAttributes. What has no colour is white, a material that is not
/// there 2^32 - 1. `model` and `objects` must outlive the pass.
std::unique_ptr<AttributePass> PassOverThreeMf(const ThreeMfModel& model,
                                               const std::vector<ThreeMfMeshObject>& objects,
                                               std::vector<MeshAttribute> wanted,
                                               std::function<ThreeMfPlace(std::uint64_t)> locate,
                                               RunContext& context);

}  // namespace strata::io
