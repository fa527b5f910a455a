#include "io/three_mf_attributes.h"

#include <array>
#include <cstring>
#include <optional>
#include <span>
#include <utility>

namespace strata::io {
namespace {

using Kind = ThreeMfGroup::Kind;
constexpr std::uint32_t kNone = ThreeMfProperty::kNone;
constexpr ThreeMfGroup::Color kWhite = {255, 255, 255, 255};

// An entry of a group that is not one of layers.
struct Entry {
  const ThreeMfGroup* group = nullptr;  // Null: none.
  std::uint32_t number = 0;
};

class ThreeMfPass final : public AttributePass {
 public:
  ThreeMfPass(const ThreeMfModel& model, const std::vector<ThreeMfMeshObject>& objects,
              std::vector<MeshAttribute> wanted, std::function<ThreeMfPlace(std::uint64_t)> locate,
              RunContext& context)
      : model_(model),
        objects_(objects),
        wanted_(std::move(wanted)),
        locate_(std::move(locate)),
        context_(context) {}

  Result<void> Read(std::span<const SurfacePoint> points, std::span<char* const> out) override {
    if (context_.cancelled()) return Cancelled();
    for (std::size_t i = 0; i < points.size(); ++i) {
      const ThreeMfPlace place = locate_(points[i].triangle);
      const ThreeMfProperty property = PropertyOf(place);
      for (std::size_t k = 0; k < wanted_.size(); ++k) {
        Put(wanted_[k], place, property, points[i].weight, out[k] + i * wanted_[k].bytes());
      }
    }
    return {};
  }

 private:
  ThreeMfProperty PropertyOf(const ThreeMfPlace& place) const {
    const ThreeMfObject& object = *objects_[place.object].object;
    const auto properties = object.mesh->properties.view();
    ThreeMfProperty property = object.property;
    const auto t = static_cast<std::size_t>(place.triangle);
    if (t < properties.size() && properties[t].entry[0] != kNone) {
      property = properties[t];
      if (property.group == kNone) property.group = object.property.group;
    }
    if (place.mirrored) std::swap(property.entry[1], property.entry[2]);
    return property;
  }

  void Put(const MeshAttribute& attribute, const ThreeMfPlace& place,
           const ThreeMfProperty& property, const std::array<double, 3>& weight, char* out) const {
    if (attribute.carry == Carry::kConstant) {
      const bool item = attribute.semantic == Semantic::kGeneric;
      const std::uint32_t id = item ? place.item : static_cast<std::uint32_t>(place.object);
      std::memcpy(out, &id, sizeof id);
      return;
    }
    const std::string& part = objects_[place.object].part;
    std::array<std::array<char, 4>, 3> value;
    static_assert(sizeof(ThreeMfGroup::Color) == 4 && sizeof(std::uint32_t) == 4);
    for (std::size_t v = 0; v < 3; ++v) {
      if (attribute.semantic == Semantic::kColor) {
        const Entry entry = Find(part, property.group, property.entry[v], Kind::kColors);
        const ThreeMfGroup::Color color =
            entry.group == nullptr ? kWhite : entry.group->colors[entry.number];
        std::memcpy(value[v].data(), color.data(), 4);
      } else {
        const Entry entry = Find(part, property.group, property.entry[v], Kind::kMaterials);
        const bool none = entry.group == nullptr || entry.group->kind != Kind::kMaterials;
        const std::uint32_t id = none ? kNone : entry.group->first_material + entry.number;
        std::memcpy(value[v].data(), &id, 4);
      }
    }
    CarryValue(attribute, {value[0].data(), value[1].data(), value[2].data()}, weight, out);
  }

  const ThreeMfGroup* GroupOf(const std::string& part, std::uint32_t number) const {
    const auto found = model_.groups.find({part, number});
    return found == model_.groups.end() ? nullptr : &found->second;
  }

  static bool Has(const ThreeMfGroup* group, std::uint32_t entry) {
    return group != nullptr && group->kind != Kind::kLayers && entry < group->colors.size();
  }

  // The entry itself; of layers the first of the preferred kind, else the first there is.
  Entry Find(const std::string& part, std::uint32_t number, std::uint32_t entry,
             Kind preferred) const {
    const ThreeMfGroup* const group = GroupOf(part, number);
    if (Has(group, entry)) return {group, entry};
    if (group == nullptr || group->kind != Kind::kLayers) return {};
    const std::size_t layers = group->layers.size();
    Entry found;
    for (std::size_t k = 0; k < layers; ++k) {
      const std::size_t at = static_cast<std::size_t>(entry) * layers + k;
      if (at >= group->entries.size()) break;
      const ThreeMfGroup* const layer = GroupOf(part, group->layers[k]);
      if (!Has(layer, group->entries[at])) continue;
      if (layer->kind == preferred) return {layer, group->entries[at]};
      if (found.group == nullptr) found = {layer, group->entries[at]};
    }
    return found;
  }

  const ThreeMfModel& model_;
  const std::vector<ThreeMfMeshObject>& objects_;
  const std::vector<MeshAttribute> wanted_;
  const std::function<ThreeMfPlace(std::uint64_t)> locate_;
  RunContext& context_;
};

MeshAttribute Id(const char* name, Semantic semantic, AttributeDomain domain) {
  MeshAttribute attribute;
  attribute.name = name;
  attribute.type = ScalarType::kUint32;
  attribute.semantic = semantic;
  attribute.domain = domain;
  attribute.carry = Carry::kConstant;
  return attribute;
}

}  // namespace

std::vector<MeshAttribute> ListThreeMfAttributes(const ThreeMfModel& model,
                                                 const std::vector<ThreeMfMeshObject>& objects) {
  std::vector<MeshAttribute> attributes;
  if (model.has_colors) {
    MeshAttribute& color = attributes.emplace_back();
    color.name = "color";
    color.type = ScalarType::kUint8;
    color.components = 4;
    color.domain = AttributeDomain::kCorner;
    color.normalized = true;
    color.semantic = Semantic::kColor;
    color.color_space = ColorSpace::kSrgb;
  }
  if (!model.materials.empty()) {
    // Corners of one triangle have to agree; where they do not, the nearest one is right.
    MeshAttribute material = Id("material", Semantic::kMaterial, AttributeDomain::kTriangle);
    material.carry = Carry::kNearestCorner;
    material.names = model.materials;
    attributes.push_back(std::move(material));
  }
  if (objects.empty()) return attributes;
  MeshAttribute object = Id("object", Semantic::kObject, AttributeDomain::kTriangle);
  for (const ThreeMfMeshObject& each : objects) {
    const std::string& name = each.object->name;
    object.names.push_back(name.empty() ? "object " + std::to_string(each.id) : name);
  }
  attributes.push_back(std::move(object));
  MeshAttribute item = Id("item", Semantic::kGeneric, AttributeDomain::kInstance);
  item.names = model.item_names;
  attributes.push_back(std::move(item));
  return attributes;
}

std::unique_ptr<AttributePass> PassOverThreeMf(const ThreeMfModel& model,
                                               const std::vector<ThreeMfMeshObject>& objects,
                                               std::vector<MeshAttribute> wanted,
                                               std::function<ThreeMfPlace(std::uint64_t)> locate,
                                               RunContext& context) {
  return std::make_unique<ThreeMfPass>(model, objects, std::move(wanted), std::move(locate),
                                       context);
}

}  // namespace strata::io
