#include "io/gltf_geometry.h"

#include <algorithm>
#include <utility>

#include "io/draco_header.h"
#include "io/gltf_pose.h"

namespace strata::io {
namespace {

constexpr std::uint64_t kWindow = 3 * 4096;
constexpr std::uint64_t kVerticesAtOnce = 4096;

std::string PlaceOf(std::uint32_t mesh, std::uint32_t primitive) {
  return "/meshes/" + std::to_string(mesh) + "/primitives/" + std::to_string(primitive);
}

std::uint64_t TrianglesOf(GltfMode mode, std::uint64_t corners) {
  if (mode == GltfMode::kTriangles) return (corners + 2) / 3;
  return corners > 2 ? corners - 2 : std::min<std::uint64_t>(corners, 1);
}

tl::unexpected<Error> WrongShape(const GltfBuffers& buffers, const std::string& place,
                                 const char* expected) {
  return Fail(ErrorCode::kCorruptInput, buffers.name() + ": " + place + ": expected " + expected);
}

// All of a Draco view, and the memory it takes.
struct DracoBytes {
  std::string bytes;
  MemoryShare share;
};
Result<DracoBytes> ReadDraco(GltfBuffers& buffers, std::uint32_t view, const std::string& who) {
  auto bytes = buffers.View(view);
  if (!bytes) return Forward(bytes);
  DracoBytes draco;
  if (buffers.memory() != nullptr) {
    auto share = buffers.memory()->Take((*bytes)->size(), who + ": Draco data");
    if (!share) return Forward(share);
    draco.share = std::move(*share);
  }
  draco.bytes.resize(static_cast<std::size_t>((*bytes)->size()));
  if (auto ok = (*bytes)->Read(0, draco.bytes); !ok) return Forward(ok);
  return draco;
}

Result<GltfValues> OpenPositions(GltfBuffers& buffers, const GltfDocument& document,
                                 const GltfPrimitive& primitive, const std::string& place) {
  auto values = GltfValues::Open(buffers, document, primitive.attributes.at("POSITION"));
  if (values && values->components() != 3) {
    return WrongShape(buffers, place + "/attributes/POSITION", "VEC3");
  }
  return values;
}

Result<GltfValues> OpenIndices(GltfBuffers& buffers, const GltfDocument& document,
                               const GltfPrimitive& primitive, const std::string& place) {
  auto values = GltfValues::Open(buffers, document, *primitive.indices);
  if (!values) return values;
  const GltfScalar scalar = values->accessor().scalar;
  if (values->components() != 1 || (scalar != GltfScalar::kUint8 && scalar != GltfScalar::kUint16 &&
                                    scalar != GltfScalar::kUint32)) {
    return WrongShape(buffers, place + "/indices", "SCALAR of an unsigned type");
  }
  return values;
}

}  // namespace

Result<GltfSize> MeasureGltf(GltfBuffers& buffers, const GltfDocument& document, std::uint32_t mesh,
                             std::uint32_t primitive_number) {
  const GltfPrimitive& primitive = document.meshes[mesh].primitives[primitive_number];
  const std::string place = PlaceOf(mesh, primitive_number);
  if (primitive.draco) {
    const std::string who = buffers.name() + ": " + place;
    auto draco = ReadDraco(buffers, primitive.draco->view, who);
    if (!draco) return Forward(draco);
    const auto header = ReadDracoHeader(draco->bytes, who);
    if (!header) return Forward(header);
    const std::uint32_t positions = primitive.attributes.at("POSITION");
    return GltfSize{header->faces, document.accessors[positions].count};
  }
  auto positions = OpenPositions(buffers, document, primitive, place);
  if (!positions) return Forward(positions);
  GltfSize size{TrianglesOf(primitive.mode, positions->count()), positions->count()};
  if (!primitive.indices) return size;
  auto indices = OpenIndices(buffers, document, primitive, place);
  if (!indices) return Forward(indices);
  size.triangles = TrianglesOf(primitive.mode, indices->count());
  return size;
}

GltfGeometry::GltfGeometry(GltfBuffers& buffers, const OpenOptions& options)
    : buffers_(buffers), options_(options), vertices_(buffers.name(), options) {}

Result<std::unique_ptr<GltfGeometry>> GltfGeometry::Load(
    GltfBuffers& buffers, const GltfDocument& document, const GltfScene& scene,
    const GltfDraw& draw, const OpenOptions& options, const std::set<std::string>* keep) {
  std::unique_ptr<GltfGeometry> geometry(new GltfGeometry(buffers, options));
  const GltfPrimitive& primitive = document.meshes[draw.mesh].primitives[draw.primitive];
  geometry->mode_ = primitive.draco ? GltfMode::kTriangles : primitive.mode;
  if (auto ok = primitive.draco ? geometry->LoadDraco(document, draw) : Result<void>(); !ok) {
    return Forward(ok);
  }
  const bool normals = keep != nullptr && keep->contains("NORMAL");
  if (auto ok = geometry->LoadVertices(document, scene, draw, normals); !ok) return Forward(ok);
  if (geometry->draco_) {
    if (keep != nullptr) {
      if (auto ok = geometry->Keep(document, draw, *keep); !ok) return Forward(ok);
    }
    geometry->draco_->Drop();
    geometry->has_indices_ = true;
    geometry->corner_count_ = 3 * geometry->draco_->faces().size();
  } else if (primitive.indices) {
    auto indices = OpenIndices(buffers, document, primitive, PlaceOf(draw.mesh, draw.primitive));
    if (!indices) return Forward(indices);
    geometry->has_indices_ = true;
    geometry->corner_count_ = indices->count();
    geometry->indices_ = std::move(*indices);
  } else {
    geometry->corner_count_ = geometry->vertices_.size();
  }
  return geometry;
}

Result<void> GltfGeometry::LoadDraco(const GltfDocument& document, const GltfDraw& draw) {
  const GltfPrimitive& primitive = document.meshes[draw.mesh].primitives[draw.primitive];
  const std::string who = buffers_.name() + ": " + PlaceOf(draw.mesh, draw.primitive);
  auto bytes = ReadDraco(buffers_, primitive.draco->view, who);
  if (!bytes) return Forward(bytes);
  auto mesh = DracoMesh::Decode(bytes->bytes, who, buffers_.memory());
  if (!mesh) return Forward(mesh);
  if (ReadDracoHeader(bytes->bytes, who)->faces != mesh->faces().size()) {
    return Fail(ErrorCode::kCorruptInput, who + ": the Draco data held " +
                                              std::to_string(mesh->faces().size()) +
                                              " faces, their head says more");
  }
  draco_ = std::move(*mesh);
  return {};
}

Result<void> GltfGeometry::Keep(const GltfDocument& document, const GltfDraw& draw,
                                const std::set<std::string>& keys) {
  const GltfPrimitive& primitive = document.meshes[draw.mesh].primitives[draw.primitive];
  std::uint64_t bytes = 0;
  for (const auto& [key, id] : primitive.draco->ids) {
    const auto accessor = primitive.attributes.find(key);
    if (!keys.contains(key) || accessor == primitive.attributes.end()) continue;
    const std::uint32_t components = document.accessors[accessor->second].components;
    auto values = draco_->Values(id, buffers_.name() + ": " + key.substr(0, 40), components);
    if (!values) return Forward(values);
    bytes += values->size() * sizeof(double);
    decoded_[key] = std::move(*values);
  }
  if (buffers_.memory() == nullptr) return {};
  auto share = buffers_.memory()->Take(bytes, buffers_.name() + ": values of Draco data");
  if (!share) return Forward(share);
  decoded_share_ = std::move(*share);
  return {};
}

Result<void> GltfGeometry::LoadVertices(const GltfDocument& document, const GltfScene& scene,
                                        const GltfDraw& draw, bool normals) {
  const GltfPrimitive& primitive = document.meshes[draw.mesh].primitives[draw.primitive];
  const std::string place = PlaceOf(draw.mesh, draw.primitive);
  auto pose = GltfPose::Open(buffers_, document, scene, draw, draco_ ? &*draco_ : nullptr, normals);
  if (!pose) return Forward(pose);
  std::optional<GltfValues> stored;
  std::vector<double> decoded;
  std::uint64_t count = 0;
  if (draco_) {
    const auto id = primitive.draco->ids.find("POSITION");
    if (id == primitive.draco->ids.end()) {
      return WrongShape(buffers_, place, "POSITION among the Draco attributes");
    }
    const std::string who = buffers_.name() + ": " + place;
    if (*pose == nullptr) {
      if (auto ok = draco_->AppendPositions(id->second, who, vertices_); !ok) return ok;
      return vertices_.Finish();
    }
    auto values = draco_->Values(id->second, who, 3);
    if (!values) return Forward(values);
    decoded = std::move(*values);
    count = decoded.size() / 3;
  } else {
    auto values = OpenPositions(buffers_, document, primitive, place);
    if (!values) return Forward(values);
    stored = std::move(*values);
    count = stored->count();
  }
  std::vector<double> xyz;
  for (std::uint64_t first = 0; first < count; first += kVerticesAtOnce) {
    if (options_.context != nullptr && options_.context->cancelled()) return Cancelled();
    const std::uint64_t n = std::min(count - first, kVerticesAtOnce);
    xyz.resize(static_cast<std::size_t>(3 * n));
    if (stored) {
      if (auto ok = stored->Read(first, xyz); !ok) return ok;
    } else {
      std::copy_n(decoded.begin() + static_cast<std::ptrdiff_t>(3 * first), 3 * n, xyz.begin());
    }
    if (*pose != nullptr) {
      if (auto ok = (*pose)->Apply(first, xyz); !ok) return ok;
    }
    for (std::size_t i = 0; i < xyz.size(); i += 3) {
      if (!vertices_.Append(xyz[i], xyz[i + 1], xyz[i + 2])) return vertices_.failure();
    }
  }
  if (normals) pose_ = std::move(*pose);
  return vertices_.Finish();
}

Result<void> GltfGeometry::LoadWindow(std::uint64_t at) {
  const std::uint64_t n = std::min(corner_count_ - at, kWindow);
  window_.resize(static_cast<std::size_t>(n));
  window_begin_ = at;
  if (!draco_) return indices_->Read(at, std::span<std::uint32_t>(window_));
  const auto& faces = draco_->faces();
  for (std::uint64_t i = 0; i < n; ++i) {
    window_[static_cast<std::size_t>(i)] =
        faces[static_cast<std::size_t>((at + i) / 3)][static_cast<std::size_t>((at + i) % 3)];
  }
  return {};
}

}  // namespace strata::io
