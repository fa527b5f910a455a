#include "io/draco_mesh.h"

#include <draco/compression/decode.h>

#include <algorithm>
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

// Where the value of a point begins; null if not all of its bytes are there.
const std::uint8_t* StoredValue(const draco::PointAttribute& attribute, draco::PointIndex point) {
  const draco::AttributeValueIndex at = attribute.mapped_index(point);
  if (at.value() >= attribute.size()) return nullptr;
  const std::int64_t bytes = std::int64_t{draco::DataTypeLength(attribute.data_type())} *
                             std::int64_t{attribute.num_components()};
  const std::int64_t begin = attribute.GetBytePos(at);
  const auto size = static_cast<std::int64_t>(attribute.buffer()->data_size());
  if (begin < 0 || begin > size || size - begin < bytes) return nullptr;
  return attribute.buffer()->data() + begin;
}

// Calls visit(values) with every point's value as `components` doubles.
template <class Visit>
Result<void> ForEachValue(const draco::PointCloud& cloud, const draco::PointAttribute* attribute,
                          std::uint32_t components, const std::string& who, Visit visit) {
  // Draco reads truth values as bool, which not every byte is.
  if (attribute == nullptr || attribute->num_components() != static_cast<int>(components) ||
      attribute->data_type() == draco::DT_BOOL) {
    return Fail(ErrorCode::kCorruptInput, who + ": the Draco data have no such attribute of " +
                                              std::to_string(components) + " components");
  }
  double values[16];
  for (draco::PointIndex i(0); i < cloud.num_points(); ++i) {
    const draco::AttributeValueIndex at = attribute->mapped_index(i);
    if (StoredValue(*attribute, i) == nullptr ||
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

namespace {

std::optional<ScalarType> ScalarOf(draco::DataType type) {
  switch (type) {
    case draco::DT_INT8:
      return ScalarType::kInt8;
    case draco::DT_UINT8:
    case draco::DT_BOOL:
      return ScalarType::kUint8;
    case draco::DT_INT16:
      return ScalarType::kInt16;
    case draco::DT_UINT16:
      return ScalarType::kUint16;
    case draco::DT_INT32:
      return ScalarType::kInt32;
    case draco::DT_UINT32:
      return ScalarType::kUint32;
    case draco::DT_INT64:
      return ScalarType::kInt64;
    case draco::DT_UINT64:
      return ScalarType::kUint64;
    case draco::DT_FLOAT32:
      return ScalarType::kFloat32;
    case draco::DT_FLOAT64:
      return ScalarType::kFloat64;
    default:
      return std::nullopt;
  }
}

// Names by their number: the metadata's whole numbers, if they are close to each other. An entry
// does not say of what type it is: any of four bytes could be one.
std::vector<std::string> TableOf(const draco::AttributeMetadata& metadata) {
  std::vector<std::string> names;
  const auto most = metadata.num_entries();
  for (const auto& [key, entry] : metadata.entries()) {
    std::int32_t number = 0;
    if (key == "name" || key == "file_name" || !metadata.GetEntryInt(key, &number)) continue;
    if (number < 0 || number >= most) continue;
    if (names.size() <= static_cast<std::size_t>(number)) {
      names.resize(static_cast<std::size_t>(number) + 1);
    }
    names[static_cast<std::size_t>(number)] = key;
  }
  return names;
}

// What the attribute's type says.
void SetMeaning(const draco::PointAttribute& from, MeshAttribute& attribute) {
  const bool color_type = attribute.type == ScalarType::kUint8 ||
                          attribute.type == ScalarType::kUint16 || !IsInteger(attribute.type);
  const int n = attribute.components;
  switch (from.attribute_type()) {
    case draco::GeometryAttribute::NORMAL:
      attribute.name = "vertex_normal";
      if (n == 3 && !IsInteger(attribute.type)) attribute.semantic = Semantic::kNormal;
      break;
    case draco::GeometryAttribute::COLOR:
      attribute.name = "color";
      if ((n != 3 && n != 4) || !color_type) break;
      attribute.semantic = Semantic::kColor;
      attribute.color_space = ColorSpace::kSrgb;
      attribute.normalized = IsInteger(attribute.type);
      break;
    case draco::GeometryAttribute::TEX_COORD:
      attribute.name = "uv";
      if (n == 2 && !IsInteger(attribute.type)) attribute.semantic = Semantic::kUv;
      break;
    default:
      attribute.name = "generic";
  }
}

void ReadMetadata(const draco::AttributeMetadata& metadata, MeshAttribute& attribute) {
  std::string name;
  if (metadata.GetEntryString("name", &name) && !name.empty()) attribute.name = name;
  if (attribute.semantic != Semantic::kGeneric || attribute.components != 1) return;
  if (!IsInteger(attribute.type)) return;
  attribute.names = TableOf(metadata);
  if (attribute.name == "material") attribute.semantic = Semantic::kMaterial;
  if (attribute.name == "sub_obj") attribute.semantic = Semantic::kObject;
}

}  // namespace

DracoColumns DracoMesh::Columns() const {
  const draco::PointCloud& cloud = *decoded_->mesh;
  const draco::PointAttribute* const position =
      cloud.GetNamedAttribute(draco::GeometryAttribute::POSITION);
  DracoColumns columns;
  int sets[2] = {0, 0};  // Of colours and texture coordinates so far.
  for (std::int32_t id = 0; id < cloud.num_attributes(); ++id) {
    const draco::PointAttribute& from = *cloud.attribute(id);
    const auto type = ScalarOf(from.data_type());
    if (&from == position) continue;
    if (!type || from.num_components() < 1 || from.num_components() > kMostComponents) {
      ++columns.too_wide;
      continue;
    }
    MeshAttribute attribute;
    attribute.type = *type;
    attribute.components = from.num_components();
    attribute.normalized = from.normalized() && IsInteger(*type);
    SetMeaning(from, attribute);
    if (attribute.semantic == Semantic::kColor || attribute.semantic == Semantic::kUv) {
      attribute.set = sets[attribute.semantic == Semantic::kUv ? 1 : 0]++;
      if (attribute.set > 0) attribute.name += "_" + std::to_string(attribute.set);
    }
    const auto* const metadata = cloud.GetAttributeMetadataByAttributeId(id);
    if (metadata != nullptr) ReadMetadata(*metadata, attribute);
    attribute.carry = CarryFor(*type, attribute.normalized);
    columns.attributes.push_back(std::move(attribute));
    columns.numbers.push_back(static_cast<std::uint32_t>(id));
  }
  FixNames(columns.attributes);
  return columns;
}

Result<void> DracoMesh::AppendRows(std::span<const std::uint32_t> numbers, const std::string& who,
                                   RowTable& to) const {
  const draco::PointCloud& cloud = *decoded_->mesh;
  std::vector<const draco::PointAttribute*> from;
  for (const std::uint32_t id : numbers) {
    const bool there = id < static_cast<std::uint32_t>(cloud.num_attributes());
    from.push_back(there ? cloud.attribute(static_cast<std::int32_t>(id)) : nullptr);
    if (!there) {
      return Fail(ErrorCode::kCorruptInput, who + ": the Draco data have no attribute " +
                                                std::to_string(id) +
                                                "; did the file change meanwhile?");
    }
  }
  std::vector<char> row(to.row_bytes());
  for (draco::PointIndex i(0); i < cloud.num_points(); ++i) {
    char* out = row.data();
    for (const draco::PointAttribute* const attribute : from) {
      const auto n = static_cast<std::size_t>(draco::DataTypeLength(attribute->data_type())) *
                     static_cast<std::size_t>(attribute->num_components());
      const std::uint8_t* const value = StoredValue(*attribute, i);
      if (value == nullptr || static_cast<std::size_t>(row.data() + row.size() - out) < n) {
        return Fail(ErrorCode::kCorruptInput,
                    who + ": the Draco data have no value for point " + std::to_string(i.value()));
      }
      std::memcpy(out, value, n);
      out += n;
    }
    if (auto added = to.Append(row.data()); !added) return added;
  }
  return {};
}

void DracoMesh::Drop() {
  decoded_.reset();
  share_ = MemoryShare();
}

}  // namespace strata::io
