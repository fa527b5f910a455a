// Reading a folder of tiles as docs/draco-output.md says, with a JSON and a Draco reader and
// nothing of the writer.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/support/read_draco.h"
#include "tests/support/temp_folder.h"

namespace strata::test {

struct ReadTile {
  std::string path, sha256;
  std::uint64_t count = 0, bytes = 0;
  Bounds bounds;
  std::array<std::int64_t, 3> first_step{};
  std::string file;  ///< Its bytes.
  SampleColumns samples;
};

struct ReadTileset {
  nlohmann::json json;
  double step = 0;
  std::vector<ReadTile> tiles;
};

inline Vec3 Vec3From(const nlohmann::json& json) { return {json[0], json[1], json[2]}; }

inline ReadTileset ReadTiles(const std::string& folder, AttributeSet attributes) {
  ReadTileset set;
  set.json = nlohmann::json::parse(ReadFile(folder + "/tileset.json"));
  EXPECT_EQ(set.json["format"], "strata-tiles");
  EXPECT_EQ(set.json["version"], 1);
  set.step = set.json["position_step"];
  for (const auto& entry : set.json["tiles"]) {
    ReadTile tile;
    tile.path = entry["path"];
    tile.sha256 = entry["sha256"];
    tile.count = entry["count"];
    tile.bytes = entry["bytes"];
    tile.bounds = {Vec3From(entry["min"]), Vec3From(entry["max"])};
    for (std::size_t a = 0; a < 3; ++a) tile.first_step[a] = entry["first_step"][a];
    tile.file = ReadFile(folder + "/" + tile.path);
    if (const auto cloud = DecodeDraco(tile.file)) tile.samples = DracoSamples(*cloud, attributes);
    set.tiles.push_back(std::move(tile));
  }
  return set;
}

}  // namespace strata::test
