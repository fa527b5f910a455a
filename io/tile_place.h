// Where tiles go.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/samples.h"
#include "io/sample_writer.h"

namespace strata::io {

/// Takes the tiles of one writer. Threads: one at a time.
class TilePlace {
 public:
  virtual ~TilePlace() = default;
  /// A tile's file; `path` is relative to the folder of the tiles. Errors: kIo.
  virtual Result<void> AddTile(const std::string& path, std::string_view bytes) = 0;
  /// After the last tile: their entries in the manifest, in order. Returns the bytes written.
  /// Errors: kIo.
  virtual Result<std::uint64_t> Finish(const std::vector<std::string>& entries) = 0;
  /// For messages.
  virtual const std::string& name() const = 0;
};

inline constexpr const char* kTilesFolder = "tiles";

/// What must hold before a tile is made: a lattice, a possible position error, enough memory for
/// the encoder. Errors: kInvalidArgument, kOverBudget.
Result<void> CheckTiles(const std::string& name, const SampleHeader& header,
                        const WriterResources& resources);

/// A manifest's head for these tiles. Precondition: CheckTiles.
Result<std::string> HeadOfTiles(const std::string& name, const SampleHeader& header,
                                std::uint64_t tile_samples);

/// Divides samples into tiles, each within a parcel: the largest octree nodes of a parcel that hold
/// at most resources.tile_samples samples. Precondition: CheckTiles. A sample's cell is what its
/// column says, where there is one, asked for or not; else the one that its position lies in.
/// Errors: kOverBudget, kIo.
Result<std::unique_ptr<SampleWriter>> MakeTileWriter(std::unique_ptr<TilePlace> place,
                                                     const SampleHeader& header,
                                                     const WriterResources& resources);

}  // namespace strata::io
