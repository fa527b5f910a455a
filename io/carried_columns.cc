#include "io/carried_columns.h"

#include <nlohmann/json.hpp>
#include <set>
#include <utility>

namespace strata::io {
namespace {

using Json = nlohmann::ordered_json;

std::string Line(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::vector<std::string> Suffixes(const MeshAttribute& column) {
  std::vector<std::string> names;
  const auto n = static_cast<std::size_t>(column.components);
  if (IsColor(column.semantic) && n <= 4) names = {"red", "green", "blue", "alpha"};
  if (column.semantic == Semantic::kUv && n == 2) names = {"s", "t"};
  if (column.semantic == Semantic::kNormal && n == 3) names = {"x", "y", "z"};
  for (std::size_t k = names.size(); k < n; ++k) names.push_back(std::to_string(k));
  names.resize(n);
  return names;
}

Json ToJson(const MeshAttribute& column) {
  Json json = {
      {"name", column.name}, {"type", NameOf(column.type)}, {"components", column.components}};
  if (column.semantic != Semantic::kGeneric) json["semantic"] = NameOf(column.semantic);
  if (column.set != 0) json["set"] = column.set;
  if (column.color_space != ColorSpace::kNone) json["color_space"] = NameOf(column.color_space);
  if (column.normalized) json["normalized"] = true;
  return json;
}

}  // namespace

std::vector<std::vector<std::string>> ComponentNames(std::span<const MeshAttribute> columns) {
  std::vector<std::vector<std::string>> names;
  std::set<std::string> taken;
  bool color_seen = false, uv_seen = false;
  for (const MeshAttribute& column : columns) {
    std::vector<std::string> suffixes = Suffixes(column);
    const bool bare = (IsColor(column.semantic) && !std::exchange(color_seen, true)) ||
                      (column.semantic == Semantic::kUv && !std::exchange(uv_seen, true));
    std::vector<std::string>& of_column = names.emplace_back();
    for (const std::string& suffix : suffixes) {
      std::string name = bare ? suffix : column.name;
      if (!bare && column.components > 1) name += "_" + suffix;
      const std::string stem = name;
      for (int k = 2; !taken.insert(name).second; ++k) name = stem + "_" + std::to_string(k);
      of_column.push_back(std::move(name));
    }
  }
  return names;
}

std::string ColumnJson(const MeshAttribute& column) { return Line(ToJson(column)); }

std::string ColumnsJson(std::span<const MeshAttribute> columns) {
  Json json = Json::array();
  for (const MeshAttribute& column : columns) json.push_back(ToJson(column));
  return Line(json);
}

std::string NamesJson(const MeshAttribute& column) { return Line(column.names); }
std::string NameJson(const std::string& name) { return Line(name); }

}  // namespace strata::io
