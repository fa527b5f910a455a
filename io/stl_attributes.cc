#include "io/stl_attributes.h"

#include <cstring>
#include <utility>

#include "io/byte_cursor.h"
#include "io/indexed_attributes.h"

namespace strata::io {
namespace {

constexpr std::size_t kDataOffset = 84, kFacetBytes = 50, kAttributeAt = 48;
constexpr std::size_t kWindowBytes = std::size_t{1} << 16;
constexpr std::uint16_t kFlag = 0x8000;

std::uint16_t LoadAttribute(const char* facet) {
  std::uint16_t attribute;
  std::memcpy(&attribute, facet + kAttributeAt, sizeof attribute);
  return attribute;
}

// From 5 bits to 8.
std::uint8_t Widen(int value) { return static_cast<std::uint8_t>(((value & 31) * 255 + 15) / 31); }

// Each facet is a face with a row of its own: the attribute, then the colour.
class StlFacets final : public FaceWalker {
 public:
  StlFacets(ByteSource& source, const StlColors& colors)
      : input_(source, kWindowBytes), cursor_(input_), colors_(colors) {
    input_.Forget();
  }
  Result<void> Begin() { return cursor_.Seek(kDataOffset); }

  Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) override {
    if (triangle > at_ && !cursor_.Skip((triangle - at_) * kFacetBytes)) return cursor_.failure();
    at_ = triangle;
    if (!cursor_.Have(kFacetBytes)) return cursor_.failure();
    const std::uint16_t attribute = LoadAttribute(cursor_.data());
    const auto color = colors_.ColorOf(attribute);
    face.first = triangle;
    face.corners = 3;
    face.values.resize(sizeof attribute + sizeof color);
    std::memcpy(face.values.data(), &attribute, sizeof attribute);
    std::memcpy(face.values.data() + sizeof attribute, color.data(), sizeof color);
    return {};
  }

 private:
  InputBuffer input_;
  ByteCursor cursor_;
  const StlColors colors_;
  std::uint64_t at_ = 0;
};

}  // namespace

StlColors StlColors::Of(std::string_view head) {
  StlColors colors;
  const std::size_t magics = head.substr(0, 80).find("COLOR=");
  if (magics != std::string_view::npos && magics + 10 <= 80) {
    colors.kind = Kind::kMagics;
    std::memcpy(colors.whole.data(), head.data() + magics + 6, colors.whole.size());
  } else if (head.size() >= kDataOffset + kFacetBytes &&
             (LoadAttribute(head.data() + kDataOffset) & kFlag) != 0) {
    colors.kind = Kind::kVisCam;
  }
  return colors;
}

std::array<std::uint8_t, 3> StlColors::ColorOf(std::uint16_t a) const {
  const bool flag = (a & kFlag) != 0;
  if (kind == Kind::kVisCam && flag) return {Widen(a >> 10), Widen(a >> 5), Widen(a)};
  if (kind == Kind::kMagics && !flag) return {Widen(a), Widen(a >> 5), Widen(a >> 10)};
  return whole;
}

std::vector<MeshAttribute> StlColors::Attributes() const {
  MeshAttribute attribute;
  attribute.name = "attribute";
  attribute.type = ScalarType::kUint16;
  attribute.domain = AttributeDomain::kTriangle;
  attribute.carry = Carry::kConstant;
  if (kind == Kind::kNone) return {attribute};
  MeshAttribute color = attribute;
  color.name = "color";
  color.type = ScalarType::kUint8;
  color.components = 3;
  color.semantic = Semantic::kColor;
  color.color_space = ColorSpace::kSrgb;
  color.normalized = true;
  return {attribute, color};
}

Result<std::unique_ptr<AttributePass>> OpenStlAttributes(ByteSource& source,
                                                         const StlColors& colors,
                                                         std::span<const MeshAttribute> wanted,
                                                         RunContext& context) {
  auto facets = std::make_unique<StlFacets>(source, colors);
  if (auto begun = facets->Begin(); !begun) return Forward(begun);
  IndexedMesh mesh;
  mesh.name = source.name();
  mesh.faces = std::move(facets);
  std::vector<AttributeSource> sources;
  for (const MeshAttribute& attribute : wanted) {
    AttributeSource& from = sources.emplace_back();
    from.place = AttributeSource::Place::kFace;
    from.field.type = attribute.type;
    const bool color = attribute.semantic == Semantic::kColor;
    for (int k = 0; k < attribute.components; ++k) {
      from.field.offset.push_back(color ? 2 + static_cast<std::size_t>(k) : 0);
    }
  }
  return PassOver(std::move(mesh), {wanted.begin(), wanted.end()}, std::move(sources), context);
}

}  // namespace strata::io
