#include "io/gltf_attributes.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "io/gltf_accessor.h"
#include "io/gltf_geometry.h"
#include "io/gltf_pose.h"

namespace strata::io {
namespace {

constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();
// A column of values above this is read value by value.
constexpr std::uint64_t kMostColumn = std::uint64_t{64} << 20;

ScalarType TypeOf(const GltfAccessor& accessor) {
  if (accessor.normalized) return ScalarType::kFloat32;
  constexpr ScalarType kTypes[] = {ScalarType::kInt8,   ScalarType::kUint8,  ScalarType::kInt16,
                                   ScalarType::kUint16, ScalarType::kUint32, ScalarType::kFloat32};
  return kTypes[static_cast<std::size_t>(accessor.scalar)];
}

// The number behind "COLOR_" or "TEXCOORD_"; none if it is no such key.
std::optional<int> SetOf(const std::string& key, const std::string& prefix) {
  const std::string digits = key.starts_with(prefix) ? key.substr(prefix.size()) : "";
  const bool number =
      !digits.empty() && digits.size() < 4 && digits.find_first_not_of("0123456789") == digits.npos;
  return number ? std::optional(std::stoi(digits)) : std::nullopt;
}

std::string Numbered(const char* name, int set) {
  return set == 0 ? name : std::string(name) + '_' + std::to_string(set);
}

std::optional<MeshAttribute> VertexAttribute(const std::string& key, const GltfAccessor& accessor) {
  MeshAttribute attribute;
  attribute.components = static_cast<int>(accessor.components);
  if (key == "NORMAL") {
    attribute.name = "normal";
    attribute.semantic = Semantic::kNormal;
    return attribute.components == 3 ? std::optional(attribute) : std::nullopt;
  }
  if (const auto set = SetOf(key, "COLOR_")) {
    attribute.name = Numbered("color", *set);
    attribute.semantic = Semantic::kColor;
    attribute.color_space = ColorSpace::kLinear;
    attribute.set = *set;
    const bool fits = attribute.components == 3 || attribute.components == 4;
    return fits ? std::optional(attribute) : std::nullopt;
  }
  if (const auto set = SetOf(key, "TEXCOORD_")) {
    attribute.name = Numbered("uv", *set);
    attribute.semantic = Semantic::kUv;
    attribute.set = *set;
    return attribute.components == 2 ? std::optional(attribute) : std::nullopt;
  }
  if (!key.starts_with('_')) return std::nullopt;
  attribute.name = key;
  attribute.type = TypeOf(accessor);
  attribute.carry = CarryFor(attribute.type, false);
  return attribute;
}

GltfColumn Constant(const char* name, Semantic semantic, GltfColumn::From from,
                    AttributeDomain domain, std::vector<std::string> names) {
  GltfColumn column;
  column.attribute.name = name;
  column.attribute.type = ScalarType::kUint32;
  column.attribute.domain = domain;
  column.attribute.carry = Carry::kConstant;
  column.attribute.semantic = semantic;
  column.attribute.names = std::move(names);
  column.from = from;
  return column;
}

template <class T>
std::vector<std::string> NamesOf(const std::vector<T>& things) {
  std::vector<std::string> names;
  for (const T& thing : things) names.push_back(thing.name);
  return names;
}

// What the type cannot hold is 0: a file whose parts contradict each other.
template <class T>
void Store(double value, char* out) {
  using Limits = std::numeric_limits<T>;
  const bool fits = !Limits::is_integer || (value >= static_cast<double>(Limits::lowest()) &&
                                            value <= static_cast<double>(Limits::max()));
  const T typed = fits ? static_cast<T>(value) : T{};
  std::memcpy(out, &typed, sizeof(T));
}

void Store(ScalarType type, double value, char* out) {
  WithType(type, [&](auto zero) { Store<decltype(zero)>(value, out); });
}

// The values of one vertex attribute of a primitive.
class Values {
 public:
  Result<void> Open(const GltfPassInput& input, const GltfPrimitive& primitive,
                    const std::string& key, const GltfGeometry& geometry) {
    const auto found = primitive.attributes.find(key);
    if (found == primitive.attributes.end()) return {};
    const bool three = input.document.accessors[found->second].components == 3;
    if (key == "NORMAL" && three) pose_ = geometry.pose();
    if (const std::vector<double>* decoded = geometry.Decoded(key)) {
      column_ = *decoded;
      components_ = input.document.accessors[found->second].components;
      return {};
    }
    auto values = GltfValues::Open(input.buffers, input.document, found->second);
    if (!values) return Forward(values);
    if (values->count() != geometry.vertices().size()) {
      return Fail(ErrorCode::kCorruptInput,
                  input.buffers.name() + ": " + key.substr(0, 40) + ": found " +
                      std::to_string(values->count()) + " values for " +
                      std::to_string(geometry.vertices().size()) + " vertices");
    }
    components_ = values->components();
    stored_ = std::move(*values);
    return LoadColumn(input);
  }

  std::uint32_t components() const { return components_; }  // 0: there are none.

  Result<void> Get(std::uint64_t vertex, std::span<double> out) {
    if (column_.empty()) {
      if (auto ok = stored_->Read(vertex, out); !ok) return ok;
    } else {
      std::copy_n(column_.begin() + static_cast<std::ptrdiff_t>(vertex * components_), out.size(),
                  out.begin());
    }
    return pose_ == nullptr ? Result<void>() : pose_->ApplyToNormals(vertex, out);
  }

 private:
  // All of them, where memory allows.
  Result<void> LoadColumn(const GltfPassInput& input) {
    const std::uint64_t bytes = stored_->count() * components_ * sizeof(double);
    if (bytes > kMostColumn) return {};
    if (input.options.memory != nullptr) {
      auto share = input.options.memory->Take(bytes, input.buffers.name());
      if (!share) return {};
      share_ = std::move(*share);
    }
    column_.resize(static_cast<std::size_t>(stored_->count() * components_));
    return stored_->Read(0, column_);
  }

  GltfPose* pose_ = nullptr;
  std::optional<GltfValues> stored_;
  std::vector<double> column_;
  std::uint32_t components_ = 0;
  MemoryShare share_;
};

class GltfPass : public AttributePass {
 public:
  GltfPass(GltfPassInput input, std::vector<GltfColumn> columns, RunContext& context)
      : input_(std::move(input)), columns_(std::move(columns)), context_(context) {
    for (const GltfColumn& column : columns_) {
      if (!column.key.empty()) keys_.insert(column.key);
      if (column.from == GltfColumn::From::kTexture) LookUpTextures(column.attribute);
    }
  }

  Result<void> Read(std::span<const SurfacePoint> points, std::span<char* const> out) override {
    for (std::size_t i = 0; i < points.size(); ++i) {
      const GltfPlace place = input_.locate(points[i].triangle);
      if (auto ok = Enter(place.draw); !ok) return ok;
      auto corners = geometry_->Corners(place.triangle);
      if (!corners) return Forward(corners);
      if (corners->size() < 3) return Absent();
      std::array<std::int64_t, 3> at{(*corners)[0], (*corners)[1], (*corners)[2]};
      for (const std::int64_t corner : at) {
        if (static_cast<std::uint64_t>(corner) >= geometry_->vertices().size()) return Absent();
      }
      const Affine& transform = input_.scene.instances[place.instance].transform;
      // As the reader handed them out.
      if (transform.Determinant() < 0) std::swap(at[1], at[2]);
      for (std::size_t k = 0; k < columns_.size(); ++k) {
        char* const to = out[k] + i * columns_[k].attribute.bytes();
        if (auto ok = Put(k, place, at, points[i].weight, to); !ok) return ok;
      }
    }
    return colors_ ? colors_->Flush() : Result<void>();
  }

 private:
  void LookUpTextures(const MeshAttribute& attribute) {
    colors_.emplace(input_.images, input_.materials, attribute.components, context_);
    for (const std::uint32_t material : MaterialsOf(input_.document, input_.draws)) {
      const BaseColor& color = input_.materials[material];
      if (color.image) keys_.insert(UvKey(color));
    }
  }
  static std::string UvKey(const BaseColor& color) {
    return "TEXCOORD_" + std::to_string(color.uv_set);
  }

  tl::unexpected<Error> Absent() const {
    return Fail(ErrorCode::kCorruptInput, input_.buffers.name() +
                                              ": a triangle is not there any more; did the file "
                                              "change meanwhile?");
  }

  // Loads the primitive of a draw.
  Result<void> Enter(std::size_t draw) {
    if (geometry_ != nullptr && draw == draw_) return {};
    if (context_.cancelled()) return Cancelled();
    geometry_.reset();
    values_.clear();
    input_.buffers.Trim();
    auto loaded = GltfGeometry::Load(input_.buffers, input_.document, input_.scene,
                                     input_.draws[draw], input_.options, &keys_);
    if (!loaded) return Forward(loaded);
    geometry_ = std::move(*loaded);
    draw_ = draw;
    values_.resize(columns_.size());
    for (std::size_t k = 0; k < columns_.size(); ++k) {
      std::string key = columns_[k].key;
      if (columns_[k].from == GltfColumn::From::kTexture && Primitive().material) {
        const BaseColor& color = input_.materials[*Primitive().material];
        if (color.image) key = UvKey(color);
      }
      if (key.empty()) continue;
      if (auto ok = values_[k].Open(input_, Primitive(), key, *geometry_); !ok) return ok;
    }
    return {};
  }

  const GltfPrimitive& Primitive() const {
    const GltfDraw& draw = input_.draws[draw_];
    return input_.document.meshes[draw.mesh].primitives[draw.primitive];
  }
  std::uint32_t IdOf(GltfColumn::From from, const GltfPlace& place) const {
    const GltfInstance& instance = input_.scene.instances[place.instance];
    switch (from) {
      case GltfColumn::From::kMaterial:
        return Primitive().material.value_or(kNone);
      case GltfColumn::From::kMesh:
        return input_.draws[draw_].mesh;
      case GltfColumn::From::kNode:
        return instance.node;
      default:
        return instance.instance;
    }
  }

  Result<void> Put(std::size_t k, const GltfPlace& place, const std::array<std::int64_t, 3>& at,
                   const std::array<double, 3>& weight, char* to) {
    const GltfColumn& column = columns_[k];
    if (column.from == GltfColumn::From::kTexture) return PutTexture(values_[k], at, weight, to);
    if (column.from != GltfColumn::From::kVertex) {
      const std::uint32_t id = IdOf(column.from, place);
      std::memcpy(to, &id, sizeof(id));
      return {};
    }
    const MeshAttribute& attribute = column.attribute;
    const auto components = static_cast<std::size_t>(attribute.components);
    const Affine& transform = input_.scene.instances[place.instance].transform;
    const bool normal = attribute.semantic == Semantic::kNormal;
    std::array<std::array<char, 8 * kMostComponents>, 3> bytes;
    for (std::size_t v = 0; v < 3; ++v) {
      std::array<double, kMostComponents> value;
      value.fill(Fallback(attribute));
      if (normal && values_[k].components() == 0) {
        const Vec3 n = FlatNormal(at, transform.Determinant() < 0);
        value[0] = n.x, value[1] = n.y, value[2] = n.z;
      } else if (const std::size_t n = values_[k].components(); n > 0) {
        std::array<double, 16> found{};
        if (auto ok = values_[k].Get(static_cast<std::uint64_t>(at[v]), std::span(found).first(n));
            !ok) {
          return ok;
        }
        std::copy_n(found.begin(), std::min(n, components), value.begin());
      }
      if (normal) {
        const Vec3 n = transform.TurnNormal({value[0], value[1], value[2]});
        value[0] = n.x, value[1] = n.y, value[2] = n.z;
      }
      for (std::size_t c = 0; c < components; ++c) {
        Store(attribute.type, value[c], bytes[v].data() + c * SizeOf(attribute.type));
      }
    }
    CarryValue(attribute, {bytes[0].data(), bytes[1].data(), bytes[2].data()}, weight, to);
    return {};
  }

  // What there is of texture coordinates; without any they are NaN.
  Result<void> PutTexture(Values& values, const std::array<std::int64_t, 3>& at,
                          const std::array<double, 3>& weight, char* to) {
    std::array<std::array<double, 2>, 3> corner;
    const std::size_t n = values.components();
    for (std::size_t v = 0; v < 3; ++v) {
      corner[v].fill(std::numeric_limits<double>::quiet_NaN());
      if (n < 2) continue;
      std::array<double, 16> found;
      const auto vertex = static_cast<std::uint64_t>(at[v]);
      if (auto ok = values.Get(vertex, std::span(found).first(n)); !ok) return ok;
      corner[v] = {found[0], found[1]};
    }
    const auto [u, v] = CarryUv(corner, weight);
    return colors_->Add(Primitive().material, u, v, to);
  }

  static double Fallback(const MeshAttribute& attribute) {
    if (attribute.semantic == Semantic::kColor) return 1;
    return IsInteger(attribute.type) ? 0 : std::numeric_limits<double>::quiet_NaN();
  }

  Vec3 Position(std::int64_t vertex) {
    const VertexStore& vertices = geometry_->vertices();
    const auto i = static_cast<std::uint64_t>(vertex);
    return vertices.far() != nullptr ? vertices.far()->At(i)
                                     : vertices.view()[static_cast<std::size_t>(i)];
  }

  // In the primitive's own space, where a mirrored triangle's corners go round the other way.
  Vec3 FlatNormal(const std::array<std::int64_t, 3>& at, bool mirrored) {
    const Vec3 a = Position(at[0]), b = Position(at[mirrored ? 2 : 1]);
    const Vec3 c = Position(at[mirrored ? 1 : 2]);
    const Vec3 n = Cross(b - a, c - a);
    const double length = Norm(n);
    return length > 0 ? n * (1 / length) : n;
  }

  const GltfPassInput input_;
  const std::vector<GltfColumn> columns_;
  RunContext& context_;
  std::set<std::string> keys_;
  std::unique_ptr<GltfGeometry> geometry_;
  std::size_t draw_ = 0;
  std::vector<Values> values_;
  std::optional<BaseColorLookup> colors_;  // If the texture is wanted.
};

}  // namespace

std::vector<std::uint32_t> MaterialsOf(const GltfDocument& document,
                                       const std::vector<GltfDraw>& draws) {
  std::set<std::uint32_t> used;
  for (const GltfDraw& draw : draws) {
    const auto& material = document.meshes[draw.mesh].primitives[draw.primitive].material;
    if (material) used.insert(*material);
  }
  return {used.begin(), used.end()};
}

std::vector<GltfColumn> ListGltfColumns(const GltfDocument& document,
                                        const std::vector<BaseColor>& materials,
                                        const std::vector<GltfDraw>& draws) {
  using From = GltfColumn::From;
  std::map<std::string, MeshAttribute> found;
  for (const GltfDraw& draw : draws) {
    const GltfPrimitive& primitive = document.meshes[draw.mesh].primitives[draw.primitive];
    for (const auto& [key, number] : primitive.attributes) {
      auto attribute = VertexAttribute(key, document.accessors[number]);
      if (!attribute) continue;
      const auto [it, fresh] = found.try_emplace(key, *attribute);
      // The widest of several.
      if (!fresh && attribute->components > it->second.components) {
        it->second.components = attribute->components;
      }
      if (!fresh && attribute->type != it->second.type) it->second.type = ScalarType::kFloat64;
    }
  }
  std::vector<GltfColumn> columns;
  for (auto& [key, attribute] : found) {
    attribute.carry = CarryFor(attribute.type, false);
    columns.push_back({attribute, From::kVertex, key});
  }
  if (draws.empty()) return columns;
  const auto triangle = AttributeDomain::kTriangle, instance = AttributeDomain::kInstance;
  if (!document.contents.materials.empty()) {
    columns.push_back(Constant("material", Semantic::kMaterial, From::kMaterial, triangle,
                               document.contents.materials));
  }
  columns.push_back(
      Constant("mesh", Semantic::kMesh, From::kMesh, triangle, NamesOf(document.meshes)));
  if (!document.nodes.empty()) {
    columns.push_back(
        Constant("node", Semantic::kNode, From::kNode, instance, NamesOf(document.nodes)));
  }
  const bool instanced = std::any_of(document.nodes.begin(), document.nodes.end(),
                                     [](const GltfNode& node) { return !node.instancing.empty(); });
  if (instanced) {
    columns.push_back(Constant("instance", Semantic::kGeneric, From::kInstance, instance, {}));
  }
  bool textured = false, opaque = true;
  for (const std::uint32_t material : MaterialsOf(document, draws)) {
    const BaseColor& color = materials[material];
    textured = textured || color.image || color.fault;
    opaque = opaque && color.opaque;
  }
  if (textured) columns.push_back({TextureAttribute(opaque), From::kTexture, ""});
  std::vector<MeshAttribute> attributes;
  for (const GltfColumn& column : columns) attributes.push_back(column.attribute);
  FixNames(attributes);
  for (std::size_t k = 0; k < columns.size(); ++k) columns[k].attribute = attributes[k];
  return columns;
}

std::unique_ptr<AttributePass> PassOverGltf(GltfPassInput input, std::vector<GltfColumn> columns,
                                            RunContext& context) {
  return std::make_unique<GltfPass>(std::move(input), std::move(columns), context);
}

}  // namespace strata::io
