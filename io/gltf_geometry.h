// One primitive of a glTF file, ready to be handed out.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "io/draco_mesh.h"
#include "io/gltf_accessor.h"
#include "io/gltf_buffers.h"
#include "io/gltf_document.h"
#include "io/gltf_pose.h"
#include "io/gltf_scene.h"
#include "io/open_mesh.h"
#include "io/placed_reader.h"
#include "io/vertex_store.h"

namespace strata::io {

/// What a primitive amounts to.
struct GltfSize {
  std::uint64_t triangles = 0;  ///< A rest that makes none counts as one.
  std::uint64_t vertices = 0;
};
/// Without loading it; checks that all bytes it names are there. Errors: kCorruptInput and those of
/// GltfBuffers. Precondition: it has triangles and a POSITION.
Result<GltfSize> MeasureGltf(GltfBuffers& buffers, const GltfDocument& document, std::uint32_t mesh,
                             std::uint32_t primitive);

/// The vertices of a primitive as its draw poses them (in memory or, beyond the budget, in scratch
/// space), and its corners, read as they are asked for. Memory: the vertices; the indices where
/// they were compressed; small buffers. Threads: one at a time.
class GltfGeometry : public PlacedGeometry {
 public:
  /// `keep`: attributes whose values Decoded gives afterwards, if Draco has packed them; with
  /// NORMAL also what poses them. All others must outlive the geometry. Errors: those of
  /// MeasureGltf, kOverBudget, kIo.
  static Result<std::unique_ptr<GltfGeometry>> Load(GltfBuffers& buffers,
                                                    const GltfDocument& document,
                                                    const GltfScene& scene, const GltfDraw& draw,
                                                    const OpenOptions& options,
                                                    const std::set<std::string>* keep = nullptr);

  const VertexStore& vertices() const override { return vertices_; }
  /// Component after component, vertex after vertex; null for what is not packed or was not kept.
  const std::vector<double>* Decoded(const std::string& key) const {
    const auto found = decoded_.find(key);
    return found == decoded_.end() ? nullptr : &found->second;
  }
  /// What moves its normals; null if nothing does, or they were not to be kept.
  GltfPose* pose() const { return pose_.get(); }
  /// The corners of triangle `number`, in the order of the specification; fewer than three for a
  /// rest. Valid until the next call. Errors: kIo.
  Result<std::span<const std::int64_t>> Corners(std::uint64_t number) override {
    switch (mode_) {
      case GltfMode::kStrip:
        return Three(number, number + 1 + number % 2, number + 2 - number % 2);
      case GltfMode::kFan:
        return Three(number + 1, number + 2, 0);
      default:
        return Three(3 * number, 3 * number + 1, 3 * number + 2);
    }
  }

 private:
  GltfGeometry(GltfBuffers& buffers, const OpenOptions& options);
  Result<void> LoadVertices(const GltfDocument& document, const GltfScene& scene,
                            const GltfDraw& draw, bool normals);
  Result<void> LoadDraco(const GltfDocument& document, const GltfDraw& draw);
  Result<void> Keep(const GltfDocument& document, const GltfDraw& draw,
                    const std::set<std::string>& keys);
  Result<std::span<const std::int64_t>> Three(std::uint64_t a, std::uint64_t b, std::uint64_t c) {
    std::size_t n = 0;
    for (const std::uint64_t at : {a, b, c}) {
      if (at >= corner_count_) continue;
      if (at - window_begin_ >= window_.size() && has_indices_) {
        if (auto ok = LoadWindow(at); !ok) return Forward(ok);
      }
      corners_[n++] = static_cast<std::int64_t>(
          has_indices_ ? window_[static_cast<std::size_t>(at - window_begin_)] : at);
    }
    return std::span<const std::int64_t>(corners_.data(), n);
  }
  Result<void> LoadWindow(std::uint64_t at);

  GltfBuffers& buffers_;
  const OpenOptions& options_;
  VertexStore vertices_;
  GltfMode mode_ = GltfMode::kTriangles;
  std::uint64_t corner_count_ = 0;
  bool has_indices_ = false;
  std::optional<GltfValues> indices_;
  std::optional<DracoMesh> draco_;
  std::unique_ptr<GltfPose> pose_;
  std::map<std::string, std::vector<double>> decoded_;
  MemoryShare decoded_share_;
  std::vector<std::uint32_t> window_;  // Corners from window_begin_ on.
  std::uint64_t window_begin_ = 0;
  std::array<std::int64_t, 3> corners_{};
};

}  // namespace strata::io
