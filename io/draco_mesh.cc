#include "io/draco_mesh.h"

#include <draco/compression/decode.h>

#include <cstring>
#include <new>
#include <utility>

#include "io/draco_header.h"

namespace strata::io {

struct DracoMesh::Decoded {
  std::unique_ptr<draco::Mesh> mesh;
};

DracoMesh::DracoMesh() = default;
DracoMesh::DracoMesh(DracoMesh&&) noexcept = default;
DracoMesh& DracoMesh::operator=(DracoMesh&&) noexcept = default;
DracoMesh::~DracoMesh() = default;

Result<DracoMesh> DracoMesh::Decode(std::string_view bytes, const std::string& who,
                                    MemoryAccount* memory) {
  const auto header = ReadDracoHeader(bytes, who);
  if (!header) return Forward(header);
  DracoMesh mesh;
  if (memory != nullptr) {
    auto share = memory->Take(DracoDecodeBytes(*header), who + ": decoding Draco data");
    if (!share) return Forward(share);
    mesh.share_ = std::move(*share);
    auto faces = memory->Take(header->faces * 12, who + ": the faces of Draco data");
    if (!faces) return Forward(faces);
    mesh.faces_share_ = std::move(*faces);
  }
  try {
    draco::DecoderBuffer buffer;
    buffer.Init(bytes.data(), bytes.size());
    draco::Decoder decoder;
    auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
    if (!decoded.ok()) {
      return Fail(ErrorCode::kCorruptInput,
                  who + ": the Draco data are damaged: " + decoded.status().error_msg_string());
    }
    mesh.decoded_ = std::make_unique<Decoded>(Decoded{std::move(decoded).value()});
    const draco::Mesh& result = *mesh.decoded_->mesh;
    mesh.points_ = result.num_points();
    mesh.faces_.reserve(result.num_faces());
    for (draco::FaceIndex i(0); i < result.num_faces(); ++i) {
      const auto& face = result.face(i);
      mesh.faces_.push_back({face[0].value(), face[1].value(), face[2].value()});
    }
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, who + ": out of memory while decoding Draco data");
  }
  return mesh;
}

namespace {

// Calls visit(values) with every point's value as `components` doubles.
template <class Visit>
Result<void> ForEachValue(const draco::PointCloud& cloud, const draco::PointAttribute* attribute,
                          std::uint32_t components, const std::string& who, Visit visit) {
  if (attribute == nullptr || attribute->num_components() != static_cast<int>(components)) {
    return Fail(ErrorCode::kCorruptInput, who + ": the Draco data have no such attribute of " +
                                              std::to_string(components) + " components");
  }
  double values[16];
  for (draco::PointIndex i(0); i < cloud.num_points(); ++i) {
    const draco::AttributeValueIndex at = attribute->mapped_index(i);
    if (at.value() >= attribute->size() ||
        !attribute->ConvertValue<double>(at, static_cast<std::int8_t>(components), values)) {
      return Fail(ErrorCode::kCorruptInput,
                  who + ": the Draco data have no value for point " + std::to_string(i.value()));
    }
    if (auto ok = visit(values); !ok) return ok;
  }
  return {};
}

}  // namespace

Result<void> DracoMesh::AppendPositions(std::optional<std::uint32_t> unique_id,
                                        const std::string& who, VertexStore& to) const {
  const draco::PointCloud& cloud = *decoded_->mesh;
  const draco::PointAttribute* const attribute =
      unique_id ? cloud.GetAttributeByUniqueId(*unique_id)
                : cloud.GetNamedAttribute(draco::GeometryAttribute::POSITION);
  return ForEachValue(cloud, attribute, 3, who, [&](const double* p) -> Result<void> {
    if (!to.Append(p[0], p[1], p[2])) return to.failure();
    return {};
  });
}

Result<std::vector<double>> DracoMesh::Values(std::uint32_t unique_id, const std::string& who,
                                              std::uint32_t components) const {
  const draco::PointCloud& cloud = *decoded_->mesh;
  std::vector<double> values;
  auto ok = ForEachValue(cloud, cloud.GetAttributeByUniqueId(unique_id), components, who,
                         [&](const double* p) -> Result<void> {
                           values.insert(values.end(), p, p + components);
                           return {};
                         });
  if (!ok) return Forward(ok);
  return values;
}

void DracoMesh::Drop() {
  decoded_.reset();
  share_ = MemoryShare();
}

}  // namespace strata::io
