// Writing samples in any supported format.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "core/memory_account.h"
#include "core/run_context.h"
#include "core/samples.h"
#include "core/scratch.h"

namespace strata::io {

/// Draco counts values, samples times components, in an int; triangle ids have four components.
inline constexpr std::uint64_t kMostTileSamples = 0x7FFF'FFFF / 4;
inline constexpr std::uint64_t kDefaultTileSamples = 4'000'000;

enum class SampleFormat { kDraco, kPly, kXyz, kNpz, kCsv, kGlb, kVdb };

/// "drc", "ply", "xyz", "npz", "csv", "glb" or "vdb".
std::optional<SampleFormat> SampleFormatFromName(std::string_view name);
/// From the suffix of `path`, case ignored.
std::optional<SampleFormat> SampleFormatFromPath(std::string_view path);

/// The manifest of a folder of tiles, by which such a folder is known.
inline constexpr const char* kTilesetName = "tileset.json";

/// Where a writer may put what does not stream. None of it changes a byte of the output but
/// tile_samples.
struct WriterResources {
  MemoryAccount* memory = nullptr;      ///< Null: no bound. Must outlive the writer.
  ScratchFolder* scratch = nullptr;     ///< Null: samples wait in memory. Must outlive the writer.
  const RunContext* context = nullptr;  ///< Its cancel flag is looked at in Finish; may be null.
  /// A `drc` output of more samples is a folder of tiles, each of at most as many; 1 to
  /// kMostTileSamples.
  std::uint64_t tile_samples = kDefaultTileSamples;
  /// Where such an output is a stream or an open file, which cannot be a folder: the folder as a
  /// zip of stored members, the manifest last, instead of an error.
  bool tiles_in_zip = false;
  /// The program strata-vdb, which a `vdb` output needs: OpenVDB's library is its alone.
  std::string vdb_program{};
};

/// Whether a `vdb` can be written with it. Errors: kUnsupported.
Result<void> CheckVdbProgram(const std::string& program);

/// Opens `path` for writing ("-" is standard output). The output appears under its name, whole,
/// when Finish returns; until then a temporary file in the same folder holds it. PLY, XYZ and CSV
/// stream in O(1) memory; NPZ, GLB, VDB and Draco need the resources. Errors: kEmptySurface,
/// kInvalidArgument, kIo; kUnsupported (CheckVdbProgram); kOverBudget when the format or the memory
/// cannot hold header.count samples.
Result<std::unique_ptr<SampleWriter>> OpenSampleWriter(const std::string& path, SampleFormat format,
                                                       const SampleHeader& header,
                                                       const WriterResources& resources = {});

}  // namespace strata::io
