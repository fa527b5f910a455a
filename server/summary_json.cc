#include "server/summary_json.h"

#include <numeric>
#include <sstream>

#include "core/version.h"
#include "server/human_units.h"
#include "server/json_parts.h"
#include "server/memory.h"

namespace strata::server {
namespace {

Json ReadToJson(const ReadCounts& read, const SkipCounts& skipped) {
  return {{"vertices", read.vertices},
          {"faces", read.faces},
          {"triangles", read.triangles},
          {"skipped", SkippedToJson(skipped)}};
}

Json StagesToJson(const SampleStats& stats, const JobFigures& figures) {
  const auto passes = static_cast<std::uint64_t>(stats.passes);
  return {
      {"open", {{"seconds", figures.open_seconds}, {"bytes", figures.open_bytes}}},
      {"lattice",
       {{"seconds", stats.lattice_seconds}, {"bytes", (passes - 1) * figures.scan_bytes}}},
      {"scan", {{"seconds", stats.scan_seconds}, {"bytes", figures.scan_bytes}}},
      {"reject", {{"seconds", stats.reject_seconds}}},
      {"attributes", {{"seconds", stats.carry_seconds}}},
      {"write", {{"seconds", figures.write_seconds}, {"bytes", figures.write_bytes}}},
      {"picture", {{"seconds", figures.picture_seconds}}},
  };
}

std::uint64_t Sum(const SkipCounts& skipped) {
  return std::accumulate(skipped.begin(), skipped.end(), std::uint64_t{0});
}

/// " (zero_area 3, non_finite 1)"; empty when nothing was skipped.
std::string SkippedByReason(const SkipCounts& skipped) {
  std::string text;
  for (std::size_t i = 0; i < skipped.size(); ++i) {
    if (skipped[i] == 0) continue;
    text += text.empty() ? " (" : ", ";
    text += std::string(kSkipReasonNames[i]) + ' ' + Grouped(skipped[i]);
  }
  return text.empty() ? text : text + ')';
}

std::string PointText(Vec3 p) { return Short(p.x, 9) + ' ' + Short(p.y, 9) + ' ' + Short(p.z, 9); }

std::string BoundsText(const Bounds& bounds) {
  return bounds.empty() ? "none" : PointText(bounds.min) + "  to  " + PointText(bounds.max);
}

// A name of the file's, or a message with such names, harmless on a terminal.
constexpr std::size_t kMostOfName = 200, kMostOfMessage = 1000;
std::string Printable(const std::string& name, std::size_t most = kMostOfName) {
  std::string text;
  for (const char c : name.substr(0, most)) text += c >= ' ' && c != '\x7f' ? c : '?';
  return text.empty() ? "(unnamed)" : text;
}

std::string Listed(const std::vector<std::string>& names) {
  constexpr std::size_t kMost = 10;
  std::string text = Grouped(names.size());
  for (std::size_t i = 0; i < names.size() && i < kMost; ++i) {
    text += (i == 0 ? ": " : ", ") + Printable(names[i]);
  }
  return names.size() > kMost ? text + ", …" : text;
}

// Lines of what is there; none for what is not.
std::string ContentsText(const MeshContents& contents) {
  std::ostringstream out;
  if (contents.meshes) {
    out << "meshes     " << Grouped(*contents.meshes) << ", placed "
        << Grouped(contents.instances.value_or(0)) << " times\n";
  }
  if (!contents.unit.empty()) out << "unit       " << Printable(contents.unit) << '\n';
  if (!contents.up_axis.empty()) out << "up         " << contents.up_axis << '\n';
  if (!contents.materials.empty()) out << "materials  " << Listed(contents.materials) << '\n';
  if (!contents.textures.empty()) out << "textures   " << Listed(contents.textures) << '\n';
  for (const auto& [what, n] : contents.passed_over) {
    out << "passed     " << Grouped(n) << ' ' << what << '\n';
  }
  return out.str();
}

Json RangeToJson(const AttributeRange& each) {
  const MeshAttribute& attribute = each.attribute;
  Json json = {{"name", attribute.name},
               {"type", NameOf(attribute.type)},
               {"components", attribute.components},
               {"domain", NameOf(attribute.domain)},
               {"semantic", NameOf(attribute.semantic)},
               {"color_space", NameOf(attribute.color_space)},
               {"normalized", attribute.normalized},
               {"names", attribute.names},
               {"min", nullptr},
               {"max", nullptr}};
  if (!each.min.empty()) json["min"] = each.min, json["max"] = each.max;
  json["fault"] = each.fault.empty() ? Json() : Json(each.fault);
  return json;
}

std::string RangeText(const AttributeRange& each) {
  std::string text = Describe(each.attribute);
  if (!each.fault.empty()) return text + ": not readable: " + Printable(each.fault, kMostOfMessage);
  for (std::size_t i = 0; i < each.min.size(); ++i) {
    text += (i == 0 ? ": " : ", ") + Short(each.min[i]) + " to " + Short(each.max[i]);
  }
  return text;
}

Json TextureToJson(const MeshTexture& texture) {
  const auto text = [](const std::string& s) { return s.empty() ? Json() : Json(s); };
  return {
      {"place", texture.place}, {"type", text(texture.type)},     {"bytes", texture.bytes},
      {"width", texture.width}, {"height", texture.height},       {"channels", texture.channels},
      {"bits", texture.bits},   {"materials", texture.materials}, {"fault", text(texture.fault)}};
}

std::string TextureText(const MeshTexture& texture, const MeshContents& contents) {
  std::string text = Printable(texture.place) + ": ";
  if (!texture.fault.empty()) {
    text += "not readable: " + Printable(texture.fault, kMostOfMessage);
  } else {
    text += texture.type + ", " + Grouped(texture.width) + " x " + Grouped(texture.height) + ", " +
            std::to_string(texture.channels) + " x " + std::to_string(texture.bits) + " bits";
  }
  std::vector<std::string> materials;
  for (const std::uint32_t k : texture.materials) materials.push_back(contents.materials.at(k));
  return materials.empty() ? text + "; base colour of no material"
                           : text + "; base colour of " + Listed(materials);
}

}  // namespace

std::string SummaryJson(const SampleCommand& command, const SampleStats& stats,
                        const JobFigures& figures) {
  Json json = {{"program", "strata"},
               {"version", kVersion},
               {"input", command.input},
               {"output", command.output},
               {"surface_hash", stats.surface_hash},
               {"mesh", ToJson(figures.mesh)}};
  json["mesh"].update(ReadToJson(stats.read, stats.skipped));
  json["mesh"]["sampled"] = stats.sampled;
  json["mesh"]["bounds"] = ToJson(stats.bounds);
  json["mesh"]["area"] = stats.mesh_area;
  json["options"] = OptionsToJson(command.options, command.position_error, stats);
  json["lattice"] = LatticeToJson(command.options.lattice, stats.lattice);
  const bool uniform = command.options.method == Method::kUniform;
  if (!uniform) {  // Which has no cells but those of the attribute.
    json["cells"] = stats.cells;
    json["cell_area"] = stats.cell_area;
    json["pieces"] = stats.pieces;
  }
  json["samples"] = {{"before_rejection", uniform ? stats.survivors : stats.cells},
                     {"after_rejection", stats.survivors}};
  json["carried"] = ToJson(figures.carried);
  json["left_out"] = stats.left_out;
  json["passes"] = stats.passes;
  json["resumed_at_triangle"] = stats.resumed_at;
  json["stages"] = StagesToJson(stats, figures);
  json["seconds"] = figures.total_seconds;
  json["threads"] = figures.threads;
  json["peak_memory_bytes"] = PeakMemoryBytes();
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
}

std::string ResumedText(std::uint64_t at) {
  return at == 0 ? "" : "; the first " + Grouped(at) + " by a former process";
}

std::string SamplesText(const SampleCommand& command, const SampleStats& stats) {
  const std::string samples = Grouped(stats.survivors);
  if (command.options.method == Method::kUniform) return samples + ", uniform by area";
  return samples + " of " + Grouped(stats.cells) + " occupied cells of edge " +
         Short(stats.lattice.edge);
}

std::string SummaryText(const SampleCommand& command, const SampleStats& stats,
                        const JobFigures& figures) {
  std::ostringstream out;
  out << "samples    " << SamplesText(command, stats) << '\n'
      << "triangles  " << Grouped(stats.sampled) << ", skipped " << Grouped(Sum(stats.skipped))
      << SkippedByReason(stats.skipped) << ResumedText(stats.resumed_at) << '\n'
      << "area       " << Short(stats.mesh_area) << '\n'
      << "time       " << Seconds(figures.total_seconds) << ": opening "
      << Seconds(figures.open_seconds) << ", scan "
      << Seconds(stats.lattice_seconds + stats.scan_seconds) << ", rejection "
      << Seconds(stats.reject_seconds) << ", writing " << Seconds(figures.write_seconds);
  if (command.picture) out << ", picture " << Seconds(figures.picture_seconds);
  out << "\nwritten    " << (command.output == "-" ? "standard output" : command.output) << ", "
      << Si(static_cast<double>(figures.write_bytes)) << "B\n";
  if (command.picture) out << "picture    " << *command.picture << '\n';
  for (const std::string& each : stats.left_out)
    out << "left out   " << Printable(each, kMostOfMessage) << '\n';
  return out.str();
}

std::string PartialText(const std::string& output, const PartialInfo& info, std::uint64_t bytes) {
  std::ostringstream out;
  out << "shares     " << info.shares.size() << " of " << info.share_count << '\n'
      << "triangles  " << Grouped(info.sampled) << ", skipped " << Grouped(Sum(info.skipped))
      << SkippedByReason(info.skipped) << '\n'
      << "written    " << (output == "-" ? "standard output" : output) << ", "
      << Si(static_cast<double>(bytes)) << "B\n";
  return out.str();
}

std::string InfoJson(const MeshInfo& info, const MeshSummary& summary,
                     const std::vector<AttributeRange>& attributes,
                     const std::vector<MeshTexture>& textures) {
  Json json = ToJson(info);
  json.update(ReadToJson(summary.read, summary.skipped));
  json["surface_triangles"] = summary.surface_triangles;
  json["bounds"] = ToJson(summary.bounds);
  json["vertex_bounds"] = ToJson(summary.vertex_bounds);
  json["area"] = summary.area;
  json["contents"] = ContentsToJson(info.contents);
  json["attributes"] = Json::array();
  for (const AttributeRange& each : attributes) json["attributes"].push_back(RangeToJson(each));
  json["textures"] = Json::array();
  for (const MeshTexture& texture : textures) json["textures"].push_back(TextureToJson(texture));
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
}

std::string InfoText(const MeshInfo& info, const MeshSummary& summary,
                     const std::vector<AttributeRange>& attributes,
                     const std::vector<MeshTexture>& textures) {
  std::ostringstream out;
  out << "format     " << info.format << ", " << info.encoding;
  if (info.compression != "none") out << ", " << info.compression;
  out << "\nvertices   " << Grouped(summary.read.vertices) << "\nfaces      "
      << Grouped(summary.read.faces) << "\ntriangles  " << Grouped(summary.read.triangles)
      << "\nskipped    " << Grouped(Sum(summary.skipped)) << SkippedByReason(summary.skipped)
      << "\nbounds     " << BoundsText(summary.bounds) << "\narea       " << Short(summary.area)
      << '\n'
      << ContentsText(info.contents);
  for (const AttributeRange& each : attributes) out << "attribute  " << RangeText(each) << '\n';
  for (const MeshTexture& texture : textures) {
    out << "texture    " << TextureText(texture, info.contents) << '\n';
  }
  return out.str();
}

}  // namespace strata::server
