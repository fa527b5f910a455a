#include "server/service/canonical_options.h"

#include <google/protobuf/util/json_util.h>

#include <algorithm>

#include "server/service/wire_options.h"

namespace strata::server {
namespace {

std::string AttributeList(const SampleOptions& options) {
  std::string names;
  for (std::size_t bit = 0; bit < kAttributeNames.size(); ++bit) {
    if ((options.attributes & (AttributeSet{1} << bit)) == 0) continue;
    names += (names.empty() ? "" : ",") + std::string(kAttributeNames[bit]);
  }
  std::vector<std::string> of_mesh = options.mesh_attributes;
  std::ranges::sort(of_mesh);  // Columns come in the mesh's order, whatever theirs.
  for (const std::string& name : of_mesh) names += (names.empty() ? "" : ",") + name;
  return names.empty() ? "none" : names;
}

}  // namespace

Result<v1::SampleOptions> Canonical(const v1::SampleOptions& options) {
  const auto command = CommandOf(options, "-", "-");
  if (!command) return Forward(command);
  const SampleOptions& checked = command->options;
  v1::SampleOptions canonical;
  if (const auto* const voxel = std::get_if<VoxelSize>(&checked.lattice)) {
    canonical.set_voxel_size(voxel->edge);
  } else if (const auto* const height = std::get_if<Height>(&checked.lattice)) {
    canonical.set_height(height->h);
  } else {
    canonical.set_resolution(std::get<Resolution>(checked.lattice).n);
  }
  canonical.set_method(checked.method == Method::kUniform ? "uniform" : "stratified");
  if (checked.count > 0) {  // Then the others have no say, and may not be given.
    canonical.set_count(checked.count);
  } else {
    canonical.set_lambda(checked.lambda);
    canonical.set_min_distance(checked.min_distance);
    canonical.set_integrator(checked.integrator == Integrator::kExact ? "exact" : "subdivide");
  }
  canonical.set_seed(checked.seed);
  canonical.set_strict(checked.strict);
  canonical.set_format(std::ranges::find(Formats(), command->format, &FormatName::format)->name);
  canonical.set_attributes(AttributeList(checked));
  if (checked.vertex_normals) canonical.set_normals("vertex");
  canonical.set_position_error(command->position_error);
  canonical.set_tile_samples(command->tile_samples);
  return canonical;
}

std::string JsonOf(const google::protobuf::Message& message) {
  google::protobuf::util::JsonPrintOptions print;
  print.preserve_proto_field_names = true;
  std::string json;
  static_cast<void>(google::protobuf::util::MessageToJsonString(message, &json, print));
  return json;
}

Result<void> FromJson(const std::string& json, google::protobuf::Message& message) {
  const auto parsed = google::protobuf::util::JsonStringToMessage(json, &message);
  if (parsed.ok()) return {};
  return Fail(ErrorCode::kInvalidArgument, "JSON: " + std::string(parsed.message()));
}

}  // namespace strata::server
