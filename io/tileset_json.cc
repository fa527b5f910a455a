#include "io/tileset_json.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "io/sha256.h"

namespace strata::io {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kVersion = 1;

Json ToJson(Vec3 v) { return Json::array({v.x, v.y, v.z}); }

// What is not UTF-8 is replaced, never thrown at.
std::string Dump(const Json& json, int indent) {
  return json.dump(indent, ' ', false, Json::error_handler_t::replace);
}

// Where a decoder puts a point: all of this is exact.
Vec3 Decoded(const FloatGrid& grid, Vec3 p) {
  const auto value = grid.ValueAt(grid.Quantize(p));
  return grid.offset + Vec3{value[0], value[1], value[2]};
}

Json FirstStep(const FloatGrid& grid) {
  const Vec3 front = grid.offset + grid.origin;
  Json steps = Json::array();
  for (int a = 0; a < 3; ++a) steps.push_back(static_cast<std::int64_t>(front[a] / grid.step));
  return steps;
}

}  // namespace

std::string TilesetHead(const SampleHeader& header, std::uint64_t tile_samples, double step) {
  Json names = Json::array({"position"});
  for (std::size_t k = 0; k < kAttributeNames.size(); ++k) {
    if ((header.attributes >> k & 1) != 0) names.push_back(kAttributeNames[k]);
  }
  for (const MeshAttribute& column : header.carried) names.push_back(column.name);
  const Json head = {
      {"format", "strata-tiles"},
      {"version", kVersion},
      {"provenance", header.provenance},
      {"count", header.count},
      {"attributes", names},
      {"lattice", {{"origin", ToJson(header.lattice_origin)}, {"edge", header.edge}}},
      {"position_error", header.position_error},
      {"position_step", step},
      {"tile_samples", tile_samples}};
  std::string text = Dump(head, 1);
  text.resize(text.size() - 2);  // Without "\n}": more follows.
  return text + ",\n \"tiles\": [";
}

Result<std::string> TileEntry(const TileFile& tile, const FloatGrid& grid, const Bounds& box) {
  std::string hash = Sha256Hex(tile.bytes);
  if (hash.empty()) return Fail(ErrorCode::kInternal, tile.path + ": no SHA-256 can be made");
  // Rounding to the grid keeps order, so the box's corners become the decoded box's.
  const Json entry = {{"path", tile.path},
                      {"count", tile.count},
                      {"bytes", tile.bytes.size()},
                      {"sha256", std::move(hash)},
                      {"min", ToJson(Decoded(grid, box.min))},
                      {"max", ToJson(Decoded(grid, box.max))},
                      {"first_step", FirstStep(grid)}};
  return Dump(entry, -1);
}

std::string TilesetText(std::string head, std::span<const std::string> entries) {
  const char* separator = "\n  ";
  for (const std::string& entry : entries) {
    head += separator;
    head += entry;
    separator = ",\n  ";
  }
  return head + "\n ]\n}\n";
}

bool BeginsWithHead(std::string_view text, std::string_view head) {
  // Before it stands nothing but the provenance, in which a quote is escaped.
  constexpr std::string_view kCount = "\n \"count\": ";
  const std::size_t count = head.find(kCount) + kCount.size();
  if (text.substr(0, count) != head.substr(0, count)) return false;
  const auto after_digits = [](std::string_view from) {
    return from.substr(std::min(from.find_first_not_of("0123456789"), from.size()));
  };
  return after_digits(text.substr(count)).starts_with(after_digits(head.substr(count)));
}

}  // namespace strata::io
