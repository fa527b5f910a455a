#include "io/three_mf_package.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <string_view>

#include "io/decimal.h"
#include "io/quote.h"
#include "io/text_scanner.h"
#include "io/xml_stream.h"

namespace strata::io {
namespace {

using namespace std::string_view_literals;

constexpr std::string_view kCore = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02|";
constexpr std::string_view kMaterials =
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02|";
constexpr std::string_view kProductionPath =
    "http://schemas.microsoft.com/3dmanufacturing/production/2015/06|path";
constexpr std::string_view kModelRelation =
    "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";
// Required extensions that are read, or say nothing about the surface of meshes.
constexpr std::array kReadExtensions = {
    "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"sv,
    "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"sv,
    "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"sv};
constexpr std::size_t kMostParts = 4096;
constexpr ThreeMfGroup::Color kNoColor = {255, 255, 255, 255};

tl::unexpected<Error> Corrupt(const std::string& what) {
  return Fail(ErrorCode::kCorruptInput, what);
}

// "/3D/a.model" as the archive calls it.
std::string MemberOf(std::string_view part) {
  while (part.starts_with('/')) part.remove_prefix(1);
  return std::string(part);
}

// The first relation to a model in _rels/.rels.
class Relations : public XmlStream::Handler {
 public:
  Result<void> Begin(std::string_view name, const XmlAttributes& attributes) override {
    const char* const type = attributes.Find("Type");
    const char* const target = attributes.Find("Target");
    const char* const mode = attributes.Find("TargetMode");
    if (!name.ends_with("|Relationship") || type == nullptr || target == nullptr) return {};
    if (type != kModelRelation || !model.empty()) return {};
    if (mode != nullptr && std::string_view(mode) == "External") {
      return Fail(ErrorCode::kUnsupported, "the model is said to be outside the package");
    }
    model = MemberOf(target);
    return {};
  }
  Result<void> End(std::string_view) override { return {}; }

  std::string model;
};

class ModelHandler : public XmlStream::Handler {
 public:
  ModelHandler(ThreeMfModel& model, std::string part, bool root, const std::string& name,
               const OpenOptions& options)
      : model_(model), part_(std::move(part)), root_(root), name_(name), options_(options) {}

  std::vector<std::string> parts;  // That components and items name.

  void Prefix(std::string_view prefix, std::string_view uri) override {
    prefixes_[std::string(prefix)] = std::string(uri);
  }

  Result<void> Begin(std::string_view name, const XmlAttributes& attributes) override {
    if (name.starts_with(kMaterials)) {
      return BeginMaterials(name.substr(kMaterials.size()), attributes);
    }
    if (!name.starts_with(kCore)) return {};
    name.remove_prefix(kCore.size());
    if (name == "vertex") return Vertex(attributes);
    if (name == "triangle") return Triangle(attributes);
    if (name == "object") return Object(attributes);
    if (name == "mesh") return Mesh();
    if (name == "component") return Component(attributes);
    if (name == "item") return Item(attributes);
    if (name == "model") return Model(attributes);
    if (name == "basematerials") return Group(ThreeMfGroup::Kind::kMaterials, attributes);
    if (name == "base") return Base(attributes);
    return {};
  }

  Result<void> End(std::string_view name) override {
    if (name.ends_with("|basematerials") || name.ends_with("|colorgroup") ||
        name.ends_with("|multiproperties")) {
      group_ = nullptr;
    }
    if (!name.starts_with(kCore)) return {};
    name.remove_prefix(kCore.size());
    if (name == "mesh" && mesh_ != nullptr) {
      if (auto ok = mesh_->vertices.Finish(); !ok) return ok;
      mesh_.reset();
    }
    if (name == "object") object_ = nullptr;
    return {};
  }

 private:
  static Result<const char*> Need(const XmlAttributes& attributes, const char* name) {
    const char* const value = attributes.Find(name);
    if (value == nullptr) return Corrupt(std::string("expected an attribute ") + name);
    return value;
  }
  static Result<double> Number(const XmlAttributes& attributes, const char* name) {
    const auto text = Need(attributes, name);
    if (!text) return Forward(text);
    double value = 0;
    if (!ParseWholeDecimal(*text, value)) {
      return Corrupt(std::string(name) + ": found " + Quoted(*text) + ", expected a number");
    }
    return value;
  }
  static Result<std::uint64_t> Whole(const XmlAttributes& attributes, const char* name) {
    const auto text = Need(attributes, name);
    if (!text) return Forward(text);
    const char* const last = *text + std::strlen(*text);
    std::uint64_t value = 0;
    const auto [end, error] = std::from_chars(*text, last, value);
    if (error != std::errc() || end != last) {
      return Corrupt(std::string(name) + ": found " + Quoted(*text) + ", expected a whole number");
    }
    return value;
  }

  Result<void> Model(const XmlAttributes& attributes) {
    const char* const unit = attributes.Find("unit");
    if (root_ && unit != nullptr) model_.unit = unit;
    const char* const required = attributes.Find("requiredextensions");
    std::string_view rest = required == nullptr ? "" : required;
    while (!rest.empty()) {
      const std::size_t space = std::min(rest.find(' '), rest.size());
      const std::string prefix(rest.substr(0, space));
      rest.remove_prefix(std::min(space + 1, rest.size()));
      const auto uri = prefixes_.find(prefix);
      const bool read = prefix.empty() || (uri != prefixes_.end() &&
                                           std::find(kReadExtensions.begin(), kReadExtensions.end(),
                                                     uri->second) != kReadExtensions.end());
      if (!read) {
        return Fail(ErrorCode::kUnsupported,
                    "the extension " + Quoted(uri == prefixes_.end() ? prefix : uri->second) +
                        " is required and not read");
      }
    }
    return {};
  }

  Result<void> Object(const XmlAttributes& attributes) {
    const auto id = Whole(attributes, "id");
    if (!id) return Forward(id);
    const auto [it, fresh] = model_.objects.try_emplace({part_, *id});
    if (!fresh) return Corrupt("a second object " + std::to_string(*id));
    object_ = &it->second;
    if (const char* const called = attributes.Find("name")) object_->name = called;
    const auto property = Property(attributes, {"pindex", "pindex", "pindex"});
    if (!property) return Forward(property);
    object_->property = *property;
    return {};
  }

  // The number of `name`; `absent` where it is not there.
  static Result<std::uint32_t> WholeOr(const XmlAttributes& attributes, const char* name,
                                       std::uint32_t absent) {
    if (attributes.Find(name) == nullptr) return absent;
    const auto value = Whole(attributes, name);
    if (!value) return Forward(value);
    return static_cast<std::uint32_t>(std::min<std::uint64_t>(*value, UINT32_MAX - 1));
  }
  // Of a triangle or object. What the second and third corner do not say is as the first.
  static Result<ThreeMfProperty> Property(const XmlAttributes& attributes,
                                          const std::array<const char*, 3>& names) {
    ThreeMfProperty property;
    const auto group = WholeOr(attributes, "pid", ThreeMfProperty::kNone);
    if (!group) return Forward(group);
    property.group = *group;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto entry = WholeOr(attributes, names[i], property.entry[0]);
      if (!entry) return Forward(entry);
      property.entry[i] = *entry;
    }
    return property;
  }

  // --- Property groups --------------------------------------------------------------------------

  Result<void> BeginMaterials(std::string_view name, const XmlAttributes& attributes) {
    if (name == "color") return Color(attributes, "color");
    if (name == "multi") return Multi(attributes);
    if (name == "colorgroup") return Group(ThreeMfGroup::Kind::kColors, attributes);
    if (name == "multiproperties") return Group(ThreeMfGroup::Kind::kLayers, attributes);
    if (name == "texture2dgroup" || name == "compositematerials") ++model_.other_groups;
    return {};
  }

  Result<void> Group(ThreeMfGroup::Kind kind, const XmlAttributes& attributes) {
    const auto id = WholeOr(attributes, "id", ThreeMfProperty::kNone);
    if (!id) return Forward(id);
    if (*id == ThreeMfProperty::kNone) return Corrupt("expected an attribute id");
    const auto [it, fresh] = model_.groups.try_emplace({part_, *id});
    if (!fresh) return Corrupt("a second group of properties " + std::to_string(*id));
    group_ = &it->second;
    group_->kind = kind;
    group_->first_material = static_cast<std::uint32_t>(model_.materials.size());
    return kind == ThreeMfGroup::Kind::kLayers ? Numbers(attributes, "pids", group_->layers)
                                               : Result<void>();
  }

  // A list of whole numbers.
  static Result<void> Numbers(const XmlAttributes& attributes, const char* name,
                              std::vector<std::uint32_t>& out) {
    const auto text = Need(attributes, name);
    if (!text) return Forward(text);
    const char* p = *text;
    const char* const last = p + std::strlen(p);
    for (p = SkipBlanks(p, last); p < last; p = SkipBlanks(p, last)) {
      const auto [end, error] = std::from_chars(p, last, out.emplace_back());
      if (error != std::errc()) {
        return Corrupt(std::string(name) + ": found " + Quoted(*text) + ", expected whole numbers");
      }
      p = end;
    }
    return {};
  }

  Result<void> Base(const XmlAttributes& attributes) {
    if (group_ == nullptr) return Corrupt("a base material in no group");
    const char* const material = attributes.Find("name");
    const bool shown = attributes.Find("displaycolor") != nullptr;
    auto ok = shown ? Color(attributes, "displaycolor") : Grow(group_->colors, kNoColor);
    if (!ok) return ok;
    model_.materials.emplace_back(material == nullptr ? "" : material);
    return {};
  }

  // "#RRGGBB" or "#RRGGBBAA".
  Result<void> Color(const XmlAttributes& attributes, const char* name) {
    if (group_ == nullptr) return Corrupt("a colour in no group");
    const auto text = Need(attributes, name);
    if (!text) return Forward(text);
    const std::string_view digits = *text;
    ThreeMfGroup::Color color = kNoColor;
    bool good = digits.starts_with('#') && (digits.size() == 7 || digits.size() == 9);
    for (std::size_t i = 0; good && 2 * i + 3 <= digits.size(); ++i) {
      const char* const at = digits.data() + 1 + 2 * i;
      const auto [end, error] = std::from_chars(at, at + 2, color[i], 16);
      good = error == std::errc() && end == at + 2;
    }
    if (!good) {
      return Corrupt(std::string(name) + ": found " + Quoted(*text) +
                     ", expected a colour such as #RRGGBB or #RRGGBBAA");
    }
    model_.has_colors = true;
    return Grow(group_->colors, color);
  }

  Result<void> Multi(const XmlAttributes& attributes) {
    if (group_ == nullptr || group_->kind != ThreeMfGroup::Kind::kLayers) {
      return Corrupt("an entry of layers in no group");
    }
    std::vector<std::uint32_t> entry;
    if (auto ok = Numbers(attributes, "pindices", entry); !ok) return ok;
    // What is not there is the first.
    entry.resize(group_->layers.size());
    for (const std::uint32_t index : entry) {
      if (auto ok = Grow(group_->entries, index); !ok) return ok;
    }
    return {};
  }

  // Appends, taking the memory from the account first.
  template <class T>
  Result<void> Grow(std::vector<T>& to, const T& value) {
    if (to.size() == to.capacity()) {
      const std::size_t more = std::max<std::size_t>(64, to.size());
      if (options_.memory != nullptr) {
        auto share = options_.memory->Take(more * sizeof(T), name_ + ": groups of properties");
        if (!share) return Forward(share);
        model_.shares.push_back(std::move(*share));
      }
      to.reserve(to.size() + more);
    }
    to.push_back(value);
    return {};
  }

  Result<void> Mesh() {
    if (object_ == nullptr || object_->mesh != nullptr) return Corrupt("a mesh in no object");
    mesh_ = object_->mesh = std::make_shared<ThreeMfMesh>(name_, options_);
    return {};
  }

  Result<void> Vertex(const XmlAttributes& attributes) {
    if (mesh_ == nullptr) return Corrupt("a vertex in no mesh");
    if (mesh_->corners.size() > 0) return Corrupt("a vertex behind triangles");
    const auto x = Number(attributes, "x"), y = Number(attributes, "y"),
               z = Number(attributes, "z");
    for (const auto* value : {&x, &y, &z}) {
      if (!*value) return Forward(*value);
    }
    if (!mesh_->vertices.Append(*x, *y, *z)) return mesh_->vertices.failure();
    return {};
  }

  Result<void> Triangle(const XmlAttributes& attributes) {
    if (mesh_ == nullptr) return Corrupt("a triangle in no mesh");
    GrowArray<std::uint32_t>& corners = mesh_->corners;
    if (corners.size() == corners.capacity() && options_.memory != nullptr) {
      auto share = options_.memory->Take(2 * corners.size() + 1024, name_ + ": the triangles");
      if (!share) return Forward(share);
      mesh_->shares.push_back(std::move(*share));
    }
    std::uint32_t found[3];
    for (int i = 0; i < 3; ++i) {
      constexpr const char* kNames[] = {"v1", "v2", "v3"};
      const auto corner = Whole(attributes, kNames[i]);
      if (!corner) return Forward(corner);
      // What no vertex can be stays so.
      found[i] = static_cast<std::uint32_t>(std::min<std::uint64_t>(*corner, UINT32_MAX));
    }
    std::copy_n(found, 3, corners.Extend(3).begin());
    const auto property = Property(attributes, {"p1", "p2", "p3"});
    if (!property) return Forward(property);
    return AddProperty(*property);
  }

  // From the first triangle on that has one.
  Result<void> AddProperty(const ThreeMfProperty& property) {
    GrowArray<ThreeMfProperty>& properties = mesh_->properties;
    const bool silent = property.entry[0] == ThreeMfProperty::kNone;
    if (properties.size() == 0 && silent) return {};
    const std::size_t behind = mesh_->corners.size() / 3;
    const std::size_t missing = behind - properties.size();
    if (missing > properties.capacity() - properties.size() && options_.memory != nullptr) {
      const std::size_t bytes = (properties.size() / 2 + missing + 64) * sizeof(ThreeMfProperty);
      auto share = options_.memory->Take(bytes, name_ + ": the triangles' properties");
      if (!share) return Forward(share);
      mesh_->shares.push_back(std::move(*share));
    }
    const std::span<ThreeMfProperty> added = properties.Extend(missing);
    std::fill(added.begin(), added.end(), ThreeMfProperty());
    added.back() = property;
    return {};
  }

  Result<ThreeMfObject::Component> Reference(const XmlAttributes& attributes) {
    const auto id = Whole(attributes, "objectid");
    if (!id) return Forward(id);
    ThreeMfObject::Component component{part_, *id, {}};
    if (const char* const path = attributes.Find(kProductionPath)) {
      component.part = MemberOf(path);
      parts.push_back(component.part);
    }
    const char* const transform = attributes.Find("transform");
    if (transform == nullptr) return component;
    // Rows of three, a vector being a row: the columns of ours.
    const char* p = transform;
    const char* const last = p + std::strlen(p);
    for (std::size_t i = 0; i < 12; ++i) {
      double value = 0;
      p = SkipBlanks(p, last);
      const char* const end = p < last ? ParseDecimal(p, last, value) : nullptr;
      if (end == nullptr) return Corrupt("transform: expected 12 numbers");
      component.transform.m[4 * (i % 3) + i / 3] = value;
      p = end;
    }
    return component;
  }

  Result<void> Component(const XmlAttributes& attributes) {
    if (object_ == nullptr) return Corrupt("a component in no object");
    auto component = Reference(attributes);
    if (!component) return Forward(component);
    object_->components.push_back(std::move(*component));
    return {};
  }

  Result<void> Item(const XmlAttributes& attributes) {
    if (!root_) return {};  // Only the root's build counts.
    auto item = Reference(attributes);
    if (!item) return Forward(item);
    model_.items.push_back(std::move(*item));
    const char* const number = attributes.Find("partnumber");
    model_.item_names.emplace_back(number == nullptr ? "" : number);
    return {};
  }

  ThreeMfModel& model_;
  const std::string part_;
  const bool root_;
  const std::string& name_;
  const OpenOptions& options_;
  std::map<std::string, std::string> prefixes_;
  ThreeMfObject* object_ = nullptr;
  std::shared_ptr<ThreeMfMesh> mesh_;
  ThreeMfGroup* group_ = nullptr;
};

Result<void> Parse(ZipArchive& archive, const std::string& member, XmlStream::Handler& handler) {
  XmlStream xml(archive.name() + '#' + member, handler);
  auto streamed =
      archive.Stream(member, [&](std::span<const char> bytes) { return xml.Put(bytes); });
  if (!streamed) return streamed;
  return xml.Finish();
}

}  // namespace

Result<ThreeMfModel> ReadThreeMf(ZipArchive& archive, const OpenOptions& options) {
  Relations relations;
  if (auto ok = Parse(archive, "_rels/.rels", relations); !ok) return Forward(ok);
  if (relations.model.empty()) {
    return Fail(ErrorCode::kUnsupported,
                archive.name() + ": a package without a 3D model; expected 3MF");
  }
  ThreeMfModel model;
  std::vector<std::string> parts = {relations.model};
  for (std::size_t next = 0; next < parts.size(); ++next) {
    if (next == kMostParts) {
      return Fail(ErrorCode::kOverBudget,
                  archive.name() + ": more than " + std::to_string(kMostParts) + " model parts");
    }
    const std::string part = parts[next];
    ModelHandler handler(model, part, next == 0, archive.name(), options);
    if (auto ok = Parse(archive, part, handler); !ok) return Forward(ok);
    for (std::string& more : handler.parts) {
      if (std::find(parts.begin(), parts.end(), more) == parts.end()) {
        parts.push_back(std::move(more));
      }
    }
  }
  return model;
}

}  // namespace strata::io
