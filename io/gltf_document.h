// What the JSON of a glTF 2.0 file says, checked and as plain structures.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/affine.h"
#include "io/json_text.h"

namespace strata::io {

struct GltfBuffer {
  std::uint64_t length = 0;
  bool has_uri = false;   ///< The text stays in the JSON: it may be long.
  bool fallback = false;  ///< EXT_meshopt_compression: there is nothing in it.
};

/// EXT_meshopt_compression of a buffer view.
struct GltfMeshopt {
  enum class Mode : std::uint8_t { kAttributes, kTriangles, kIndices };
  enum class Filter : std::uint8_t { kNone, kOctahedral, kQuaternion, kExponential };
  std::uint32_t buffer = 0;
  std::uint64_t offset = 0, length = 0, count = 0;
  std::uint32_t stride = 0;
  Mode mode = Mode::kAttributes;
  Filter filter = Filter::kNone;
};

struct GltfView {
  std::uint32_t buffer = 0;
  std::uint64_t offset = 0, length = 0;
  std::uint32_t stride = 0;  ///< 0: elements follow each other.
  std::optional<GltfMeshopt> meshopt;
};

/// Numbers of an accessor's components.
enum class GltfScalar : std::uint8_t { kInt8, kUint8, kInt16, kUint16, kUint32, kFloat };
/// Bytes of one.
std::uint32_t BytesOf(GltfScalar scalar);

struct GltfSparse {
  std::uint64_t count = 0;
  std::uint32_t index_view = 0, value_view = 0;
  std::uint64_t index_offset = 0, value_offset = 0;
  GltfScalar index_scalar = GltfScalar::kUint32;
};

struct GltfAccessor {
  std::optional<std::uint32_t> view;  ///< None: zeros.
  std::uint64_t offset = 0, count = 0;
  GltfScalar scalar = GltfScalar::kFloat;
  std::uint32_t components = 1;
  bool normalized = false;
  std::optional<GltfSparse> sparse;

  std::uint32_t element_bytes() const { return components * BytesOf(scalar); }
};

/// Names as the file has them ("POSITION", "_LABEL") to accessors.
using GltfAttributes = std::map<std::string, std::uint32_t>;

/// KHR_draco_mesh_compression of a primitive.
struct GltfDraco {
  std::uint32_t view = 0;
  GltfAttributes ids;  ///< To unique ids in the Draco data.
};

enum class GltfMode : std::uint8_t {
  kPoints,
  kLines,
  kLineLoop,
  kLineStrip,
  kTriangles,
  kStrip,
  kFan
};

struct GltfPrimitive {
  GltfAttributes attributes;
  std::optional<std::uint32_t> indices, material;
  GltfMode mode = GltfMode::kTriangles;
  std::vector<GltfAttributes> targets;
  std::optional<GltfDraco> draco;
};

struct GltfMesh {
  std::string name;
  std::vector<GltfPrimitive> primitives;
  std::vector<double> weights;
};

struct GltfNode {
  std::string name;
  Affine local;
  std::vector<std::uint32_t> children;
  std::optional<std::uint32_t> mesh, skin;
  std::vector<double> weights;
  GltfAttributes instancing;  ///< EXT_mesh_gpu_instancing: TRANSLATION, ROTATION, SCALE, _…
};

struct GltfSkin {
  std::vector<std::uint32_t> joints;
  std::optional<std::uint32_t> inverse_bind;
};

struct GltfDocument {
  std::vector<GltfBuffer> buffers;
  std::vector<GltfView> views;
  std::vector<GltfAccessor> accessors;
  std::vector<GltfMesh> meshes;
  std::vector<GltfNode> nodes;
  std::vector<GltfSkin> skins;
  std::vector<std::uint32_t> roots;  ///< Of the default scene, else of all scenes.
  bool has_scenes = false;
  MeshContents contents;  ///< Materials and textures.
};

/// Reads the whole document; every index in it exists afterwards. What has no bearing on the
/// surface is not looked at. Errors: kCorruptInput, naming the place by its JSON pointer;
/// kUnsupported for a version other than 2 and required extensions that are not read.
Result<GltfDocument> ReadGltfDocument(const nlohmann::json& root, const std::string& name);

}  // namespace strata::io
