#include "io/assimp_records.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "io/assimp_stream.h"

namespace strata::io {
namespace {

constexpr std::size_t kMostTextBytes = std::size_t{64} << 20;
// Values are read so many corners at a time, and memory grows with them.
constexpr std::size_t kCornersAtOnce = 4096;

}  // namespace

template <class T>
Result<T> AssimpRecords::Number() {
  std::array<char, sizeof(T)> bytes;
  if (auto ok = feed_.Take(bytes); !ok) return Forward(ok);
  T value;
  std::memcpy(&value, bytes.data(), sizeof(T));
  return value;
}

template <class T>
Result<void> AssimpRecords::Values(std::size_t count, std::size_t each, std::vector<T>& out) {
  out.clear();
  while (count > 0 && each > 0) {
    const std::size_t n = std::min(count, kCornersAtOnce) * each, at = out.size();
    out.resize(at + n);
    auto taken = feed_.Take({reinterpret_cast<char*>(out.data() + at), n * sizeof(T)});
    if (!taken) return taken;
    count -= n / each;
  }
  return {};
}

Result<std::string> AssimpRecords::Text() {
  const auto length = Number<std::uint32_t>();
  if (!length) return Forward(length);
  text_bytes_ += *length;
  if (*length > kMostAssimpText || text_bytes_ > kMostTextBytes) return Nonsense();
  std::string text(*length, '\0');
  if (auto ok = feed_.Take(text); !ok) return Forward(ok);
  return text;
}

Result<void> AssimpRecords::List(std::vector<std::string>& out) {
  const auto count = Number<std::uint32_t>();
  if (!count) return Forward(count);
  if (*count > kMostAssimpNames) return Nonsense();
  for (std::uint32_t i = 0; i < *count; ++i) {
    auto text = Text();
    if (!text) return Forward(text);
    out.push_back(std::move(*text));
  }
  return {};
}

tl::unexpected<Error> AssimpRecords::Nonsense() const {
  return Fail(ErrorCode::kCorruptInput,
              name_ + ": the process that reads it sent what cannot be understood");
}

tl::unexpected<Error> AssimpRecords::Failure() {
  const auto code = Number<std::uint32_t>();
  if (!code) return Forward(code);
  auto text = Text();
  if (!text) return Forward(text);
  for (char& c : *text) c = c >= ' ' && c <= '~' ? c : ' ';
  const ErrorCode kind = *code == 1   ? ErrorCode::kOverBudget
                         : *code == 2 ? ErrorCode::kUnsupported
                                      : ErrorCode::kCorruptInput;
  return Fail(kind, name_ + ": assimp: " + *text);
}

Result<AssimpHead> AssimpRecords::Head() {
  const auto record = Number<std::uint32_t>();
  if (!record) return Forward(record);
  if (*record == static_cast<std::uint32_t>(AssimpRecord::kFailure)) return Failure();
  if (*record != static_cast<std::uint32_t>(AssimpRecord::kHead)) return Nonsense();
  AssimpHead head;
  for (std::uint64_t* const count :
       {&head.vertices, &head.meshes, &head.placings, &head.points, &head.lines}) {
    const auto number = Number<std::uint64_t>();
    if (!number) return Forward(number);
    *count = *number;
  }
  auto format = Text();
  if (!format) return Forward(format);
  head.format = std::move(*format);
  if (auto ok = List(head.material_names); !ok) return Forward(ok);
  auto up = Text();
  if (!up) return Forward(up);
  head.up_axis = std::move(*up);
  std::array<std::uint32_t, 3> sets{};
  for (std::uint32_t& each : sets) {
    const auto number = Number<std::uint32_t>();
    if (!number) return Forward(number);
    each = *number;
  }
  if (sets[0] > 1 || sets[1] > kMostAssimpSets || sets[2] > kMostAssimpSets) return Nonsense();
  head.normals = sets[0] == 1;
  head.colors = sets[1];
  head.uvs = sets[2];
  if (auto ok = List(head.mesh_names); !ok) return Forward(ok);
  if (auto ok = List(head.node_names); !ok) return Forward(ok);
  width_ = attributes_ ? head.width() : 0;
  return head;
}

Result<bool> AssimpRecords::Next(AssimpPolygon& polygon) {
  for (;;) {
    const auto record = Number<std::uint32_t>();
    if (!record) return Forward(record);
    switch (static_cast<AssimpRecord>(*record)) {
      case AssimpRecord::kEnd:
        return false;
      case AssimpRecord::kFailure:
        return Failure();
      case AssimpRecord::kPlaced:
        for (std::uint32_t& id : ids_) {
          const auto number = Number<std::uint32_t>();
          if (!number) return Forward(number);
          id = *number;
        }
        continue;
      case AssimpRecord::kPolygon:
        break;
      default:
        return Nonsense();
    }
    const auto corners = Number<std::uint32_t>();
    if (!corners) return Forward(corners);
    if (*corners > kMostAssimpCorners) return Nonsense();
    polygon.ids = ids_;
    static_assert(sizeof(Vec3) == 3 * sizeof(double));
    if (auto ok = Values(*corners, 1, polygon.corners); !ok) return Forward(ok);
    if (auto ok = Values(*corners, width_, polygon.values); !ok) return Forward(ok);
    return true;
  }
}

AssimpColumns ListAssimpColumns(const AssimpHead& head) {
  AssimpColumns columns;
  const auto add = [&](std::string name, int components, Semantic semantic, std::size_t offset) {
    MeshAttribute& attribute = columns.attributes.emplace_back();
    attribute.name = std::move(name);
    attribute.components = components;
    attribute.semantic = semantic;
    attribute.domain = AttributeDomain::kCorner;
    columns.offsets.push_back(offset);
    return &attribute;
  };
  std::size_t at = head.normals ? 3 : 0;
  for (std::uint32_t set = 0; set < head.colors; ++set, at += 4) {
    const std::string suffix = set == 0 ? "" : "_" + std::to_string(set);
    MeshAttribute* const color = add("color" + suffix, 4, Semantic::kColor, at);
    color->set = static_cast<int>(set);
    color->color_space = ColorSpace::kSrgb;
  }
  for (std::uint32_t set = 0; set < head.uvs; ++set, at += 2) {
    const std::string suffix = set == 0 ? "" : "_" + std::to_string(set);
    add("uv" + suffix, 2, Semantic::kUv, at)->set = static_cast<int>(set);
  }
  if (head.normals) add("vertex_normal", 3, Semantic::kNormal, 0);
  const auto add_id = [&](const char* name, Semantic semantic, AttributeDomain domain,
                          std::size_t which, const std::vector<std::string>& names) {
    if (names.empty()) return;
    MeshAttribute* const id = add(name, 1, semantic, which);
    id->type = ScalarType::kUint32;
    id->domain = domain;
    id->carry = Carry::kConstant;
    id->names = names;
  };
  add_id("material", Semantic::kMaterial, AttributeDomain::kTriangle, 2, head.material_names);
  add_id("mesh", Semantic::kMesh, AttributeDomain::kTriangle, 0, head.mesh_names);
  add_id("node", Semantic::kNode, AttributeDomain::kInstance, 1, head.node_names);
  return columns;
}

}  // namespace strata::io
