// Understanding what strata-assimp writes, which nobody should rely on to be sane.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata::io {

/// Where the bytes come from.
class AssimpFeed {
 public:
  virtual ~AssimpFeed() = default;
  /// Exactly out.size() bytes. Errors: any.
  virtual Result<void> Take(std::span<char> out) = 0;
};

/// What the scene holds.
struct AssimpHead {
  std::uint64_t vertices = 0, meshes = 0, placings = 0, points = 0, lines = 0;
  std::string format, up_axis;
  std::vector<std::string> material_names, mesh_names, node_names;
  bool normals = false;
  std::uint32_t colors = 0, uvs = 0;  ///< Sets of them.

  /// Floats that a corner carries.
  std::size_t width() const { return (normals ? 3 : 0) + 4 * colors + 2 * uvs; }
};

struct AssimpPolygon {
  std::array<std::uint32_t, 3> ids{};  ///< Of mesh, node and material.
  std::vector<Vec3> corners;
  std::vector<float> values;  ///< AssimpHead::width() for each corner; empty of a surface's run.
};

/// Reads records in turn. Errors of all calls: kCorruptInput for what makes no sense; what the
/// records say went wrong (kOverBudget, kUnsupported, kCorruptInput); the feed's. Memory: names of
/// 64 MiB at most, and one polygon, whose memory grows as its bytes arrive. Threads: one.
class AssimpRecords {
 public:
  /// `name` is the mesh's, for messages; `feed` must outlive the records. `attributes`: whether
  /// corners carry values.
  AssimpRecords(std::string name, AssimpFeed& feed, bool attributes)
      : name_(std::move(name)), feed_(feed), attributes_(attributes) {}

  /// First, once.
  Result<AssimpHead> Head();
  /// The next polygon; false at the end.
  Result<bool> Next(AssimpPolygon& polygon);

 private:
  template <class T>
  Result<T> Number();
  template <class T>
  Result<void> Values(std::size_t count, std::size_t each, std::vector<T>& out);
  Result<std::string> Text();
  Result<void> List(std::vector<std::string>& out);
  tl::unexpected<Error> Failure();
  tl::unexpected<Error> Nonsense() const;

  const std::string name_;
  AssimpFeed& feed_;
  const bool attributes_;
  std::size_t width_ = 0, text_bytes_ = 0;
  std::array<std::uint32_t, 3> ids_{};
};

/// A column, and where it stands: in a corner's floats from `offset` on, or ids[offset].
struct AssimpColumns {
  std::vector<MeshAttribute> attributes;
  std::vector<std::size_t> offsets;
};

/// `color`, `color_1`, …, `uv`, …, `vertex_normal`, and `material`, `mesh` and `node` with their
/// names. Colours are taken for sRGB, which few of these formats say.
AssimpColumns ListAssimpColumns(const AssimpHead& head);

}  // namespace strata::io
