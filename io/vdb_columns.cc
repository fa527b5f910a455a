#include "io/vdb_columns.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>

#include "io/carried_columns.h"
#include "io/sample_rows.h"

namespace strata::io {
namespace {

using Json = nlohmann::ordered_json;

// OpenVDB's points have no unsigned integers: the next larger type holds all values of one. There
// is none for 64 bits: those keep their bits, and the columns' description says what they are.
VdbType TypeFor(ScalarType type) {
  switch (type) {
    case ScalarType::kInt8:
      return VdbType::kInt8;
    case ScalarType::kUint8:
    case ScalarType::kInt16:
      return VdbType::kInt16;
    case ScalarType::kUint16:
    case ScalarType::kInt32:
      return VdbType::kInt32;
    case ScalarType::kUint32:
    case ScalarType::kInt64:
    case ScalarType::kUint64:
      return VdbType::kInt64;
    case ScalarType::kFloat32:
      return VdbType::kFloat;
    case ScalarType::kFloat64:
      break;
  }
  return VdbType::kDouble;
}

bool IsColor(const MeshAttribute& column) {
  const bool numbers = column.type == ScalarType::kUint8 || column.type == ScalarType::kUint16 ||
                       !IsInteger(column.type);
  return strata::IsColor(column.semantic) && numbers && column.components >= 3 &&
         column.components <= 4;
}

bool IsUv(const MeshAttribute& column) {
  return column.semantic == Semantic::kUv && column.components == 2 && !IsInteger(column.type);
}

template <class Narrow, class Wide>
void Widen(const char* value, std::uint32_t components, char* out) {
  for (std::uint32_t k = 0; k < components; ++k) {
    Narrow narrow;
    std::memcpy(&narrow, value + k * sizeof narrow, sizeof narrow);
    const Wide wide = narrow;
    std::memcpy(out + k * sizeof wide, &wide, sizeof wide);
  }
}

void WidenIntegers(ScalarType type, const char* value, std::uint32_t components, char* out) {
  if (type == ScalarType::kUint8) return Widen<std::uint8_t, std::int16_t>(value, components, out);
  if (type == ScalarType::kUint16) {
    return Widen<std::uint16_t, std::int32_t>(value, components, out);
  }
  Widen<std::uint32_t, std::int64_t>(value, components, out);
}

// Integers stand for [0, 1]: a float is fine enough for the integer to be found again by rounding.
template <class Integer>
void Scale(const char* value, std::uint32_t components, char* out) {
  constexpr double kMost = std::numeric_limits<Integer>::max();
  for (std::uint32_t k = 0; k < components; ++k) {
    Integer integer;
    std::memcpy(&integer, value + k * sizeof integer, sizeof integer);
    const auto scaled = static_cast<float>(integer / kMost);
    std::memcpy(out + k * sizeof scaled, &scaled, sizeof scaled);
  }
}

void ScaleColor(ScalarType type, const char* value, std::uint32_t components, char* out) {
  if (type == ScalarType::kUint8) return Scale<std::uint8_t>(value, components, out);
  if (type == ScalarType::kUint16) return Scale<std::uint16_t>(value, components, out);
  std::memcpy(out, value, components * SizeOf(type));
}

struct FixedRow {
  Attribute attribute;
  const char* name;
  VdbType type;
  std::uint32_t components;
  bool vector;
  ScalarType column_type;
};
constexpr FixedRow kFixedRows[] = {
    {kNormal, "N", VdbType::kFloat, 3, true, ScalarType::kFloat32},
    {kTriangle, "triangle", VdbType::kInt64, 1, false, ScalarType::kUint64},
    {kBarycentric, "barycentric", VdbType::kDouble, 3, true, ScalarType::kFloat64},
    {kCell, "cell", VdbType::kInt32, 3, false, ScalarType::kInt32},
    {kArea, "area", VdbType::kDouble, 1, false, ScalarType::kFloat64},
    {kWeight, "weight", VdbType::kDouble, 1, false, ScalarType::kFloat64},
};

}  // namespace

VdbColumns::VdbColumns(const SampleHeader& header) {
  AddFixed(header);
  const auto& carried = header.carried;
  const auto first = [&carried](const auto& is) {
    return static_cast<std::size_t>(std::ranges::find_if(carried, is) - carried.begin());
  };
  const auto source = [&carried](std::size_t k) {
    return Source{carried[k].name, 0, k, carried[k].type,
                  static_cast<std::uint32_t>(carried[k].components)};
  };
  // What has a name by custom takes it before a column that happens to be called the same.
  const std::size_t color = first(IsColor), uv = first(IsUv);
  if (color < carried.size()) AddColor(source(color), carried[color]);
  if (uv < carried.size()) {
    Source of_uv = source(uv);
    of_uv.how = How::kUv;
    Add({"uv", TypeFor(carried[uv].type), 3, true}, std::move(of_uv));
  }
  for (std::size_t k = 0; k < carried.size(); ++k) {
    if (k != color && k != uv) AddCarried(source(k), carried[k]);
  }
}

std::string VdbColumns::NameFor(const std::string& wanted) const {
  const auto taken = [this](const std::string& name) {
    return name == "P" ||
           std::ranges::find(attributes_, name, &VdbAttribute::name) != attributes_.end();
  };
  std::string name = wanted;
  // OpenVDB's names have none of these; all else is as FixNames left it.
  std::ranges::replace_if(
      name, [](char c) { return c == '-' || c == '.'; }, '_');
  if (taken(name)) name = "mesh_" + name;
  const std::string stem = name;
  for (int k = 2; taken(name); ++k) name = stem + "_" + std::to_string(k);
  return name;
}

void VdbColumns::Add(VdbAttribute attribute, Source source) {
  attributes_.push_back(std::move(attribute));
  sources_.push_back(std::move(source));
}

void VdbColumns::AddFixed(const SampleHeader& header) {
  for (std::size_t k = 0; k < std::size(kFixedRows); ++k) {
    const FixedRow& row = kFixedRows[k];
    if ((header.attributes & row.attribute) == 0) continue;
    Add({row.name, row.type, row.components, row.vector},
        {kAttributeNames[k], static_cast<AttributeSet>(row.attribute), 0, row.column_type,
         row.components});
  }
}

void VdbColumns::AddColor(Source source, const MeshAttribute& column) {
  const VdbType type = column.type == ScalarType::kFloat64 ? VdbType::kDouble : VdbType::kFloat;
  source.how = How::kColor;
  Add({"Cd", type, 3, true}, source);
  if (column.components == 3) return;
  source.how = How::kAlpha;
  Add({"Alpha", type, 1, false}, std::move(source));
}

void VdbColumns::AddCarried(Source source, const MeshAttribute& column) {
  const VdbType type = TypeFor(column.type);
  const std::uint32_t components = source.components;
  source.how = SizeOf(type) == SizeOf(column.type) ? How::kCopy : How::kWiden;
  Add({NameFor(column.name), type, components, components == 3 && !IsInteger(column.type)},
      std::move(source));
}

void VdbColumns::Pack(const SampleColumns& columns, std::size_t i, char* out) const {
  for (std::size_t k = 0; k < sources_.size(); ++k) {
    const Source& source = sources_[k];
    const VdbAttribute& attribute = attributes_[k];
    const auto bytes = source.fixed != 0 ? ColumnBytes(columns, source.fixed)
                                         : std::string_view(columns.carried[source.carried].data(),
                                                            columns.carried[source.carried].size());
    const char* const value = bytes.data() + i * (bytes.size() / columns.size());
    switch (source.how) {
      case How::kCopy:
        std::memcpy(out, value, attribute.bytes());
        break;
      case How::kWiden:
        WidenIntegers(source.type, value, source.components, out);
        break;
      case How::kColor:
        ScaleColor(source.type, value, 3, out);
        break;
      case How::kAlpha:
        ScaleColor(source.type, value + 3 * SizeOf(source.type), 1, out);
        break;
      case How::kUv:
        std::memcpy(out, value, 2 * SizeOf(source.type));
        std::memset(out + 2 * SizeOf(source.type), 0, SizeOf(source.type));
        break;
    }
    out += attribute.bytes();
  }
}

std::vector<std::pair<std::string, std::string>> VdbColumns::Metadata(
    const SampleHeader& header) const {
  Json columns = Json::array();
  std::vector<std::pair<std::string, std::string>> metadata = {{"strata", header.provenance}};
  for (std::size_t k = 0; k < sources_.size(); ++k) {
    const Source& source = sources_[k];
    Json json = {{"attribute", attributes_[k].name}};
    if (source.fixed != 0) {
      json.update(Json{{"name", source.column},
                       {"type", NameOf(source.type)},
                       {"components", source.components}});
    } else {
      const MeshAttribute& column = header.carried[source.carried];
      json.update(Json::parse(ColumnJson(column)));
      if (!column.names.empty()) {
        metadata.emplace_back("strata_names_" + attributes_[k].name, NamesJson(column));
      }
    }
    columns.push_back(std::move(json));
  }
  metadata.emplace_back("strata_columns",
                        columns.dump(-1, ' ', false, Json::error_handler_t::replace));
  return metadata;
}

}  // namespace strata::io
