// The manifest of a tile folder: docs/draco-output.md, Tiles.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "core/samples.h"
#include "io/float_grid.h"

namespace strata::io {

/// Collects the text of tileset.json, tile by tile. Memory: the text, about 400 bytes a tile.
class TilesetJson {
 public:
  /// `step` is that of every tile's grid.
  TilesetJson(const SampleHeader& header, std::uint64_t tile_samples, double step);

  /// `bytes` is the tile's file, `box` encloses the samples it was made of.
  /// Errors: kInternal when no hash can be made.
  Result<void> Add(const std::string& path, std::uint64_t count, std::span<const char> bytes,
                   const FloatGrid& grid, const Bounds& box);
  /// The whole text. To be called once.
  std::string Finish();

 private:
  std::string text_;
  bool first_ = true;
};

}  // namespace strata::io
