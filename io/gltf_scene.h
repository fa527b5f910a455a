// The scene of a glTF file, unrolled: what is placed where.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "io/affine.h"
#include "io/gltf_buffers.h"
#include "io/gltf_document.h"

namespace strata::io {

/// One placing of a mesh.
struct GltfInstance {
  Affine transform;            ///< To the world.
  std::uint32_t node = 0;      ///< UINT32_MAX: none, of a file without nodes.
  std::uint32_t instance = 0;  ///< Within the node: 0 without EXT_mesh_gpu_instancing.
};

/// One primitive and all its placings. A node that poses its mesh, by a skin or by weights of its
/// own, has draws of its own.
struct GltfDraw {
  std::uint32_t mesh = 0, primitive = 0;
  std::optional<std::uint32_t> posed_by;  ///< The node.
  std::size_t first_instance = 0, instances = 0;
};

struct GltfScene {
  std::vector<GltfInstance> instances;
  /// By mesh, primitive, posing node: each primitive's placings stand together, so that it is
  /// loaded once.
  std::vector<GltfDraw> draws;
  std::vector<Affine> world;  ///< Of every node; where a node is reached twice, the first.
  MemoryShare share;          ///< For the instances.
};

/// Unrolls the default scene, else all scenes, else all nodes without a parent; a file without any
/// node has its meshes placed once, as they are. A node that is reached in several ways is placed
/// as often. Errors: kCorruptInput for a node that is its own descendant; kOverBudget when nodes
/// that are reached again and again amount to more than 2^20 placings.
Result<GltfScene> UnrollGltf(GltfBuffers& buffers, const GltfDocument& document);

}  // namespace strata::io
