// The manifest of a tile folder: docs/draco-output.md, Tiles.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "core/samples.h"
#include "io/float_grid.h"

namespace strata::io {

/// A manifest up to its tiles. `step` is that of every tile's grid; `header.count` is the number of
/// samples in all tiles.
std::string TilesetHead(const SampleHeader& header, std::uint64_t tile_samples, double step);

/// A tile's entry, one line. `bytes` is its file, `box` encloses the samples it was made of.
/// Errors: kInternal when no hash can be made.
struct TileFile {
  std::string path;
  std::uint64_t count = 0;
  std::span<const char> bytes;
};
Result<std::string> TileEntry(const TileFile& tile, const FloatGrid& grid, const Bounds& box);

/// The whole manifest, from its head and entries in the order of the tiles.
std::string TilesetText(std::string head, std::span<const std::string> entries);

/// Whether `text` begins as a manifest does whose head is `head`, whatever the number of samples.
bool BeginsWithHead(std::string_view text, std::string_view head);

}  // namespace strata::io
