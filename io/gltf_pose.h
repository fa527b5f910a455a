// Vertices of a glTF primitive as the file's rest pose has them.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "core/result.h"
#include "io/draco_mesh.h"
#include "io/gltf_accessor.h"
#include "io/gltf_buffers.h"
#include "io/gltf_document.h"
#include "io/gltf_scene.h"

namespace strata::io {

/// Morph targets with the weights of the node, else of the mesh, and a skin with its joints where
/// the nodes' own transforms put them. Without either, positions pass as they are. Threads: one.
class GltfPose {
 public:
  /// `draco`: the primitive's decoded data, or null; only used here. `normals`: whether they will
  /// be posed, too. Null where nothing moves. All others must outlive the pose. Errors:
  /// kCorruptInput and those of GltfValues::Open.
  static Result<std::unique_ptr<GltfPose>> Open(GltfBuffers& buffers, const GltfDocument& document,
                                                const GltfScene& scene, const GltfDraw& draw,
                                                const DracoMesh* draco, bool normals = false);
  virtual ~GltfPose() = default;
  /// Moves the positions x0,y0,z0,x1,… of the vertices from number `first` on. Errors: kIo;
  /// kCorruptInput (a joint that is not there).
  virtual Result<void> Apply(std::uint64_t first, std::span<double> xyz) = 0;
  /// The same of normals: targets are added, and joints turn what comes of it, which keeps its
  /// length. Precondition: opened with `normals`. Errors: the same.
  virtual Result<void> ApplyToNormals(std::uint64_t first, std::span<double> xyz) = 0;
};

}  // namespace strata::io
