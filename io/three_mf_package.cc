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
    if (!name.starts_with(kCore)) return {};
    name.remove_prefix(kCore.size());
    if (name == "vertex") return Vertex(attributes);
    if (name == "triangle") return Triangle(attributes);
    if (name == "object") return Object(attributes);
    if (name == "mesh") return Mesh();
    if (name == "component") return Component(attributes);
    if (name == "item") return Item(attributes);
    if (name == "model") return Model(attributes);
    if (name == "base") {
      const char* const material = attributes.Find("name");
      model_.materials.emplace_back(material == nullptr ? "" : material);
    }
    return {};
  }

  Result<void> End(std::string_view name) override {
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
