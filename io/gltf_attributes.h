// What the vertices, primitives and nodes of a glTF file carry.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/affine.h"
#include "io/base_color.h"
#include "io/gltf_buffers.h"
#include "io/gltf_document.h"
#include "io/gltf_scene.h"
#include "io/open_mesh.h"

namespace strata::io {

/// An attribute and where it comes from.
struct GltfColumn {
  enum class From : std::uint8_t { kVertex, kMaterial, kMesh, kNode, kInstance, kTexture };
  MeshAttribute attribute;
  From from = From::kVertex;
  std::string key;  ///< Of kVertex: "NORMAL", "_LABEL".
};

/// All there is in the primitives of `draws`: normals, colours, texture coordinates, the file's own
/// ("_…"), the numbers of material, mesh, node and instance, and `texture` where a material of
/// theirs names one (or tries to). Tangents, joints and weights are left out.
std::vector<GltfColumn> ListGltfColumns(const GltfDocument& document,
                                        const std::vector<BaseColor>& materials,
                                        const std::vector<GltfDraw>& draws);

/// The numbers of the materials of `draws`, ascending.
std::vector<std::uint32_t> MaterialsOf(const GltfDocument& document,
                                       const std::vector<GltfDraw>& draws);

/// A triangle's draw, its number in the primitive, and its placing among the scene's instances.
struct GltfPlace {
  std::size_t draw = 0;
  std::uint64_t triangle = 0;
  std::size_t instance = 0;
};

/// What a pass needs; all must outlive it.
struct GltfPassInput {
  GltfBuffers& buffers;
  const GltfDocument& document;
  const GltfScene& scene;
  const std::vector<GltfDraw>& draws;
  const std::vector<BaseColor>& materials;
  TextureImages& images;
  const OpenOptions& options;
  std::function<GltfPlace(std::uint64_t)> locate;
};

/// Normals are those of the rest pose. Where a primitive lacks an attribute: normals are the
/// triangle's own, colours are 1, as the specification says; others are NaN, of integers 0. A
/// material that is not there is 2^32 - 1. Memory: a primitive at a time, and a column of its
/// values where that fits.
std::unique_ptr<AttributePass> PassOverGltf(GltfPassInput input, std::vector<GltfColumn> columns,
                                            RunContext& context);

}  // namespace strata::io
