#include "server/json_parts.h"

namespace strata::server {
namespace {

struct SpecToJson {
  Json operator()(const Resolution& spec) const { return {{"resolution", spec.n}}; }
  Json operator()(const VoxelSize& spec) const { return {{"voxel_size", spec.edge}}; }
  Json operator()(const Height& spec) const { return {{"height", spec.h}}; }
};

}  // namespace

Json ToJson(Vec3 v) { return Json::array({v.x, v.y, v.z}); }

Json ToJson(const Bounds& bounds) {
  if (bounds.empty()) return nullptr;
  return {{"min", ToJson(bounds.min)}, {"max", ToJson(bounds.max)}};
}

Json ToJson(const MeshInfo& info) {
  return {{"format", info.format}, {"encoding", info.encoding}, {"compression", info.compression}};
}

Json ContentsToJson(const MeshContents& contents) {
  Json json = {{"materials", contents.materials}, {"textures", contents.textures}};
  const auto number = [](const std::optional<std::uint64_t>& n) { return n ? Json(*n) : Json(); };
  const auto text = [](const std::string& s) { return s.empty() ? Json() : Json(s); };
  json["meshes"] = number(contents.meshes);
  json["instances"] = number(contents.instances);
  json["unit"] = text(contents.unit);
  json["up_axis"] = text(contents.up_axis);
  json["passed_over"] = Json::object();
  for (const auto& [what, n] : contents.passed_over) json["passed_over"][what] = n;
  return json;
}

Json SkippedToJson(const SkipCounts& skipped) {
  Json json = Json::object();
  for (std::size_t i = 0; i < skipped.size(); ++i) json[kSkipReasonNames[i]] = skipped[i];
  return json;
}

Json AttributesToJson(const SampleOptions& options) {
  Json json = Json::array();
  for (std::size_t bit = 0; bit < kAttributeNames.size(); ++bit) {
    if (options.attributes & (AttributeSet{1} << bit)) json.push_back(kAttributeNames[bit]);
  }
  for (const std::string& name : options.mesh_attributes) json.push_back(name);
  return json;
}

Json ToJson(const std::vector<MeshAttribute>& attributes) {
  Json list = Json::array();
  for (const MeshAttribute& attribute : attributes) {
    Json json = {{"name", attribute.name},
                 {"type", NameOf(attribute.type)},
                 {"components", attribute.components},
                 {"of", NameOf(attribute.domain)},
                 {"semantic", NameOf(attribute.semantic)}};
    if (!attribute.names.empty()) json["names"] = attribute.names.size();
    list.push_back(std::move(json));
  }
  return list;
}

Json LatticeToJson(const LatticeSpec& spec, const Lattice& lattice) {
  Json json = std::visit(SpecToJson{}, spec);
  json["origin"] = ToJson(lattice.origin);
  json["edge"] = lattice.edge;
  return json;
}

Json OptionsToJson(const SampleOptions& options, double position_error, const SampleStats& stats) {
  Json json;
  if (options.method == Method::kUniform) {
    json = {{"method", "uniform"}, {"count", stats.survivors}, {"seed", options.seed}};
  } else {
    json = {{"method", "stratified"},
            {"lambda", options.lambda},
            {"min_distance", options.min_distance},
            {"seed", options.seed},
            {"integrator", options.integrator == Integrator::kExact ? "exact" : "subdivide"}};
  }
  json["attributes"] = AttributesToJson(options);
  if (options.vertex_normals) json["normals"] = "vertex";
  json["position_error"] = position_error;
  return json;
}

}  // namespace strata::server
