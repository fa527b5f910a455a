#include "io/gltf_document.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>
#include <type_traits>

namespace strata::io {
namespace {

constexpr std::uint64_t kMostBytes = std::uint64_t{1} << 53;  // What a JSON number says exactly.
constexpr std::uint64_t kMostIndex = std::numeric_limits<std::uint32_t>::max() - 1;

// Required extensions that change nothing of the surface, or that are read.
constexpr std::array<std::string_view, 8> kReadExtensions = {
    "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",    "KHR_texture_transform",   "EXT_texture_webp",
    "KHR_lights_punctual",        "KHR_xmp_json_ld"};

bool IsKnownExtension(const std::string& name) {
  return name.starts_with("KHR_materials_") ||
         std::find(kReadExtensions.begin(), kReadExtensions.end(), name) != kReadExtensions.end();
}

class Reader {
 public:
  Reader(const nlohmann::json& root, const std::string& name)
      : failure_{&name, {}, false}, root_(root, failure_) {}

  Result<GltfDocument> Read() {
    CheckVersion();
    CheckExtensions();
    Each("buffers", document_.buffers, [this](const JsonAt& at) { return Buffer(at); });
    Each("bufferViews", document_.views, [this](const JsonAt& at) { return View(at); });
    Each("accessors", document_.accessors, [this](const JsonAt& at) { return Accessor(at); });
    CountContents();
    Each("meshes", document_.meshes, [this](const JsonAt& at) { return Mesh(at); });
    // Nodes and skins name each other.
    if (!failure_.failed) node_count_ = root_["nodes"].size();
    Each("skins", document_.skins, [this](const JsonAt& at) { return Skin(at); });
    Each("nodes", document_.nodes, [this](const JsonAt& at) { return Node(at); });
    if (!failure_.failed) ReadScenes();
    if (failure_.failed) return tl::unexpected<Error>(failure_.error);
    return std::move(document_);
  }

 private:
  template <class T, class F>
  void Each(const char* key, std::vector<T>& to, F read) {
    if (failure_.failed) return;
    const JsonAt list = root_[key];
    const std::size_t size = list.size();
    to.reserve(size);
    for (std::size_t i = 0; i < size && !failure_.failed; ++i) to.push_back(read(list.at(i)));
  }

  // An index of one of `size` things.
  std::uint32_t Index(const JsonAt& at, std::size_t size) {
    const std::uint64_t index = at.Uint(kMostIndex);
    if (index >= size && !failure_.failed) {
      at.Reject("found index " + std::to_string(index) + " of " + std::to_string(size));
    }
    return static_cast<std::uint32_t>(index);
  }
  std::optional<std::uint32_t> OptionalIndex(const JsonAt& at, std::size_t size) {
    return at.present() ? std::optional(Index(at, size)) : std::nullopt;
  }

  void CheckVersion() {
    const JsonAt asset = root_["asset"];
    const std::string version = asset["version"].String();
    if (failure_.failed) return;
    if (!version.starts_with("2.") && version != "2") {
      return asset["version"].Reject(
          "found glTF version '" + version.substr(0, 20) + "', expected 2.0",
          ErrorCode::kUnsupported);
    }
    const std::string least = asset["minVersion"].String("2.0");
    if (least != "2.0") {
      asset["minVersion"].Reject("needs a reader of version '" + least.substr(0, 20) + "', not 2.0",
                                 ErrorCode::kUnsupported);
    }
  }

  void CheckExtensions() {
    const JsonAt list = root_["extensionsRequired"];
    for (std::size_t i = 0; i < list.size() && !failure_.failed; ++i) {
      const std::string extension = list.at(i).String();
      if (!failure_.failed && !IsKnownExtension(extension)) {
        list.at(i).Reject("the extension " + extension.substr(0, 80) + " is required and not read",
                          ErrorCode::kUnsupported);
      }
    }
  }

  GltfBuffer Buffer(const JsonAt& at) {
    GltfBuffer buffer;
    buffer.length = at["byteLength"].Uint(kMostBytes);
    buffer.has_uri = at["uri"].present();
    const JsonAt extensions = at["extensions"];
    if (extensions.present() && extensions["EXT_meshopt_compression"].present()) {
      buffer.fallback = extensions["EXT_meshopt_compression"]["fallback"].Bool(false);
    }
    return buffer;
  }

  std::uint64_t Bytes(const JsonAt& at) { return at.Uint(kMostBytes, 0); }

  std::uint32_t Stride(const JsonAt& at) {
    constexpr std::uint64_t kMostStride = 256;
    return static_cast<std::uint32_t>(at.Uint(kMostStride, 0));
  }

  GltfView View(const JsonAt& at) {
    GltfView view;
    view.buffer = Index(at["buffer"], document_.buffers.size());
    view.offset = Bytes(at["byteOffset"]);
    view.length = at["byteLength"].Uint(kMostBytes);
    view.stride = Stride(at["byteStride"]);
    const JsonAt extensions = at["extensions"];
    if (extensions.present() && extensions["EXT_meshopt_compression"].present()) {
      view.meshopt = Meshopt(extensions["EXT_meshopt_compression"]);
      if (view.meshopt->count * view.meshopt->stride != view.length) {
        at.Reject("found " + std::to_string(view.length) + " bytes for " +
                  std::to_string(view.meshopt->count) + " elements of " +
                  std::to_string(view.meshopt->stride));
      }
    }
    return view;
  }

  GltfMeshopt Meshopt(const JsonAt& at) {
    GltfMeshopt meshopt;
    meshopt.buffer = Index(at["buffer"], document_.buffers.size());
    meshopt.offset = Bytes(at["byteOffset"]);
    meshopt.length = at["byteLength"].Uint(kMostBytes);
    meshopt.stride = Stride(at["byteStride"]);
    meshopt.count = at["count"].Uint(kMostBytes / 256);
    meshopt.mode = OneOf<GltfMeshopt::Mode>(at["mode"], {"ATTRIBUTES", "TRIANGLES", "INDICES"});
    if (at["filter"].present()) {
      meshopt.filter = OneOf<GltfMeshopt::Filter>(
          at["filter"], {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"});
    }
    CheckMeshopt(meshopt, at);
    return meshopt;
  }

  // What the decoder's preconditions and the extension's text demand.
  static void CheckMeshopt(const GltfMeshopt& meshopt, const JsonAt& at) {
    using Mode = GltfMeshopt::Mode;
    using Filter = GltfMeshopt::Filter;
    const std::uint32_t stride = meshopt.stride;
    const bool attributes = meshopt.mode == Mode::kAttributes;
    const bool fits =
        attributes ? stride > 0 && stride % 4 == 0 && stride <= 256 : stride == 2 || stride == 4;
    if (!fits) return at["byteStride"].Reject("found " + std::to_string(stride));
    if (meshopt.mode == Mode::kTriangles && meshopt.count % 3 != 0) {
      return at["count"].Reject("found " + std::to_string(meshopt.count) +
                                ", expected a multiple of 3");
    }
    const bool filter_fits =
        meshopt.filter == Filter::kNone ||
        (attributes && (meshopt.filter == Filter::kOctahedral
                            ? stride == 4 || stride == 8
                            : meshopt.filter == Filter::kExponential || stride == 8));
    if (!filter_fits) at["filter"].Reject("does not go with the mode and stride");
  }

  template <class E>
  E OneOf(const JsonAt& at, std::initializer_list<std::string_view> names) {
    const std::string found = at.String();
    const auto name = std::find(names.begin(), names.end(), found);
    if (name == names.end() && !failure_.failed) at.Reject("found '" + found.substr(0, 40) + "'");
    return static_cast<E>(name == names.end() ? 0 : name - names.begin());
  }

  GltfScalar Scalar(const JsonAt& at) {
    const std::uint64_t type = at.Uint(kMostIndex);
    switch (type) {
      case 5120:
        return GltfScalar::kInt8;
      case 5121:
        return GltfScalar::kUint8;
      case 5122:
        return GltfScalar::kInt16;
      case 5123:
        return GltfScalar::kUint16;
      case 5125:
        return GltfScalar::kUint32;
      case 5126:
        return GltfScalar::kFloat;
      default:
        at.Reject("found component type " + std::to_string(type));
        return GltfScalar::kFloat;
    }
  }

  GltfAccessor Accessor(const JsonAt& at) {
    GltfAccessor accessor;
    accessor.view = OptionalIndex(at["bufferView"], document_.views.size());
    accessor.offset = Bytes(at["byteOffset"]);
    accessor.count = at["count"].Uint(kMostBytes / 64);
    accessor.scalar = Scalar(at["componentType"]);
    accessor.components = Components(at["type"]);
    accessor.normalized = at["normalized"].Bool(false);
    if (at["sparse"].present()) accessor.sparse = Sparse(at["sparse"]);
    return accessor;
  }

  std::uint32_t Components(const JsonAt& at) {
    constexpr std::array<std::uint32_t, 7> kComponents = {1, 2, 3, 4, 4, 9, 16};
    enum class Kind : std::uint8_t {};
    return kComponents[static_cast<std::size_t>(
        OneOf<Kind>(at, {"SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"}))];
  }

  GltfSparse Sparse(const JsonAt& at) {
    GltfSparse sparse;
    sparse.count = at["count"].Uint(kMostBytes / 64);
    const JsonAt indices = at["indices"], values = at["values"];
    sparse.index_view = Index(indices["bufferView"], document_.views.size());
    sparse.index_offset = Bytes(indices["byteOffset"]);
    sparse.index_scalar = Scalar(indices["componentType"]);
    sparse.value_view = Index(values["bufferView"], document_.views.size());
    sparse.value_offset = Bytes(values["byteOffset"]);
    return sparse;
  }

  // Materials' names and where images are, for information: whatever else is wrong with them.
  void CountContents() {
    if (failure_.failed) return;
    const nlohmann::json& root = *root_.raw();
    MeshContents& contents = document_.contents;
    contents.up_axis = "y";
    contents.unit = "metre";
    for (const char* key : {"materials", "images"}) {
      const auto list = root.find(key);
      if (list == root.end() || !list->is_array()) continue;
      for (const nlohmann::json& each : *list) {
        if (key[0] == 'm') {
          contents.materials.push_back(Text(each, "name"));
        } else {
          const std::string uri = Text(each, "uri");
          const bool embedded = uri.empty() || uri.starts_with("data:");
          contents.textures.push_back(embedded ? "embedded" : uri);
        }
      }
    }
    material_count_ = contents.materials.size();
  }
  static std::string Text(const nlohmann::json& object, const char* key) {
    if (!object.is_object()) return "";
    const auto found = object.find(key);
    return found != object.end() && found->is_string() ? found->get<std::string>() : "";
  }

  GltfAttributes Attributes(const JsonAt& at, std::size_t accessors) {
    GltfAttributes attributes;
    if (!at.present()) return attributes;
    if (!at.is_object()) return at.Reject("expected an object"), attributes;
    for (const auto& item : at.raw()->items()) {
      attributes[item.key()] = Index(at[item.key().c_str()], accessors);
    }
    return attributes;
  }

  GltfMesh Mesh(const JsonAt& at) {
    GltfMesh mesh;
    mesh.name = at["name"].Name();
    mesh.weights = Numbers(at["weights"]);
    const JsonAt primitives = at["primitives"];
    for (std::size_t i = 0; i < primitives.size() && !failure_.failed; ++i) {
      mesh.primitives.push_back(Primitive(primitives.at(i)));
    }
    return mesh;
  }

  GltfPrimitive Primitive(const JsonAt& at) {
    GltfPrimitive primitive;
    const std::size_t accessors = document_.accessors.size();
    primitive.attributes = Attributes(at["attributes"], accessors);
    primitive.indices = OptionalIndex(at["indices"], accessors);
    // Names of materials are for information: a wrong index there is no matter of the surface.
    const JsonAt material = at["material"];
    if (material.present() && material.raw()->is_number_unsigned() &&
        material.raw()->get<std::uint64_t>() < material_count_) {
      primitive.material = material.raw()->get<std::uint32_t>();
    }
    primitive.mode = static_cast<GltfMode>(at["mode"].Uint(6, 4));
    const JsonAt targets = at["targets"];
    for (std::size_t i = 0; i < targets.size() && !failure_.failed; ++i) {
      primitive.targets.push_back(Attributes(targets.at(i), accessors));
    }
    const JsonAt extensions = at["extensions"];
    if (extensions.present() && extensions["KHR_draco_mesh_compression"].present()) {
      const JsonAt draco = extensions["KHR_draco_mesh_compression"];
      primitive.draco = GltfDraco{Index(draco["bufferView"], document_.views.size()),
                                  Attributes(draco["attributes"], kMostIndex)};
    }
    return primitive;
  }

  std::vector<double> Numbers(const JsonAt& at) {
    std::vector<double> numbers;
    for (std::size_t i = 0; i < at.size() && !failure_.failed; ++i) {
      numbers.push_back(at.at(i).Number());
    }
    return numbers;
  }

  template <std::size_t n>
  std::array<double, n> Exactly(const JsonAt& at, std::array<double, n> fallback) {
    if (!at.present()) return fallback;
    const std::vector<double> numbers = Numbers(at);
    if (failure_.failed) return fallback;
    if (numbers.size() != n) {
      at.Reject("found " + std::to_string(numbers.size()) + " numbers, expected " +
                std::to_string(n));
      return fallback;
    }
    std::array<double, n> exactly{};
    std::copy(numbers.begin(), numbers.end(), exactly.begin());
    return exactly;
  }

  Affine Transform(const JsonAt& at) {
    if (at["matrix"].present()) return FromMatrix(at["matrix"]);
    const auto t = Exactly<3>(at["translation"], {0, 0, 0});
    const auto r = Exactly<4>(at["rotation"], {0, 0, 0, 1});
    const auto s = Exactly<3>(at["scale"], {1, 1, 1});
    const double norm = std::hypot(std::hypot(r[0], r[1]), std::hypot(r[2], r[3]));
    if (!(norm > 0 && std::isfinite(norm))) {
      at["rotation"].Reject("expected a unit quaternion");
      return {};
    }
    return Affine::FromTrs({t[0], t[1], t[2]}, r, {s[0], s[1], s[2]});
  }

  // Columns one after the other; the last row must be that of an affine map.
  Affine FromMatrix(const JsonAt& at) {
    const auto c = Exactly<16>(at, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1});
    if (c[3] != 0 || c[7] != 0 || c[11] != 0 || c[15] != 1) {
      at.Reject("expected the last row to be 0 0 0 1");
    }
    Affine a;
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t column = 0; column < 4; ++column) {
        a.m[4 * row + column] = c[4 * column + row];
      }
    }
    return a;
  }

  std::vector<std::uint32_t> Indices(const JsonAt& at, std::size_t size) {
    std::vector<std::uint32_t> indices;
    for (std::size_t i = 0; i < at.size() && !failure_.failed; ++i) {
      indices.push_back(Index(at.at(i), size));
    }
    return indices;
  }

  GltfSkin Skin(const JsonAt& at) {
    return {Indices(at["joints"], node_count_),
            OptionalIndex(at["inverseBindMatrices"], document_.accessors.size())};
  }

  GltfNode Node(const JsonAt& at) {
    GltfNode node;
    node.name = at["name"].Name();
    node.local = Transform(at);
    node.children = Indices(at["children"], node_count_);
    node.mesh = OptionalIndex(at["mesh"], document_.meshes.size());
    node.skin = OptionalIndex(at["skin"], document_.skins.size());
    node.weights = Numbers(at["weights"]);
    const JsonAt extensions = at["extensions"];
    if (extensions.present() && extensions["EXT_mesh_gpu_instancing"].present()) {
      node.instancing = Attributes(extensions["EXT_mesh_gpu_instancing"]["attributes"],
                                   document_.accessors.size());
    }
    return node;
  }

  void ReadScenes() {
    const JsonAt scenes = root_["scenes"];
    const std::size_t size = scenes.size();
    document_.has_scenes = size > 0;
    const auto scene = OptionalIndex(root_["scene"], size);
    for (std::size_t i = 0; i < size && !failure_.failed; ++i) {
      if (scene && *scene != i) continue;
      for (const std::uint32_t root : Indices(scenes.at(i)["nodes"], node_count_)) {
        document_.roots.push_back(root);
      }
    }
  }

  JsonAt::Failure failure_;
  JsonAt root_;
  GltfDocument document_;
  std::size_t node_count_ = 0, material_count_ = 0;
};

}  // namespace

std::uint32_t BytesOf(GltfScalar scalar) {
  constexpr std::array<std::uint32_t, 6> kBytes = {1, 1, 2, 2, 4, 4};
  return kBytes[static_cast<std::size_t>(scalar)];
}

Result<GltfDocument> ReadGltfDocument(const nlohmann::json& root, const std::string& name) {
  return Reader(root, name).Read();
}

}  // namespace strata::io
