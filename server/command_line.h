// From argv to a checked command. Nothing here touches a file.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/parcels.h"
#include "core/result.h"
#include "core/sample_mesh.h"
#include "core/scan.h"
#include "io/companion_file.h"
#include "io/sample_writer.h"
#include "server/command_text.h"
#include "server/option_table.h"

namespace strata::server {

/// `strata sample INPUT -o OUTPUT`, every value within its range.
struct SampleCommand {
  std::string input;   ///< Path, or "-" for standard input.
  std::string output;  ///< Path, or "-" for standard output.
  /// Where files are that the mesh names. Null: in the input's folder.
  std::shared_ptr<const io::CompanionFiles> companions;
  SampleOptions options;
  io::SampleFormat format = io::SampleFormat::kDraco;
  double position_error = 0.01;  ///< Fraction of the cell's edge; 1e-9 to 1.
  std::uint64_t tile_samples = io::kDefaultTileSamples;  ///< In a Draco file; 1 to 2^29 - 1.
  std::optional<std::string> summary;              ///< Where the JSON goes; "-" is standard output.
  std::optional<std::string> picture;              ///< Where the PNG goes.
  int picture_width = 1024, picture_height = 768;  ///< Its pixels.
  std::string simd = "auto";            ///< "auto" or the name of a vector instruction set.
  std::optional<std::uint64_t> memory;  ///< Bytes, at least kLeastMemory; absent = half of all.
  std::optional<std::string> scratch;   ///< Directory; absent = the system's.
  bool resume = false;                  ///< Go on with what a killed process left in scratch.
  bool tiles_in_zip = false;            ///< A stream of more samples is a zip of tiles.
  /// Where such a thing is left and gone on with whatever `resume` says, and its key, in place of
  /// scratch and JobKey. Empty: there.
  std::string checkpoint_folder, checkpoint_key;
  bool checkpoints = true;  ///< Leave something to go on with, should it be killed.
  bool quiet = false;
  bool assimp = false;  ///< Formats that Strata does not read go to assimp.
};

/// The smallest --memory, bytes.
inline constexpr std::uint64_t kLeastMemory = std::uint64_t{64} << 20;

/// `strata scan MESH --share I/N -o PART`. Of the job, what concerns scanning.
struct ScanCommand {
  SampleCommand job;
  Share share;
  std::optional<Lattice> lattice;  ///< What the lattice comes to, where that is known.
};

/// `strata merge PART... -o OUTPUT`. Of the job, what concerns gathering and writing.
struct MergeCommand {
  SampleCommand job;
  std::vector<std::string> inputs;
  bool to_partial = false;       ///< The output is a partial again.
  std::optional<Region> region;  ///< Which part of the output, a drc folder, is to be written.
};

/// `strata info MESH`.
struct InfoCommand {
  std::string input;  ///< Path, or "-" for standard input.
  bool json = false;
  bool assimp = false;  ///< Other formats through assimp.
};

/// `--help` or `--version`: what to print to standard output.
struct ShowText {
  std::string text;
};

using Command = std::variant<SampleCommand, ScanCommand, MergeCommand, InfoCommand, ShowText>;

/// Parses the arguments (the program's name is not among them).
///
/// Errors: kInvalidArgument, for one problem at a time; the message names the option, what was
/// found, its range and its default, or the nearest name for one that does not exist.
Result<Command> ParseCommandLine(std::span<const std::string> arguments);

/// `strata` itself, then its commands that ParseCommandLine knows, as --help prints them.
std::vector<CommandText> DescribeCommands();

/// The one place where the texts of a `sample` become values, whoever sent them.
/// Errors: kInvalidArgument, as ParseCommandLine.
Result<SampleCommand> CheckSample(const RawSample& raw);

/// Bytes of "268435456", "256M", "256MiB" or "1.5G": K, M, G and T are powers of 1024.
/// Errors: kInvalidArgument.
Result<std::uint64_t> ParseSize(std::string_view text);

/// What --attributes names.
struct AttributeNames {
  AttributeSet fixed = 0;
  std::vector<std::string> of_mesh;  ///< SampleOptions::mesh_attributes, each once.
};
/// The names in a comma-separated list: fixed ones become bits; "all" is everything; any other is
/// one of the mesh's, which only the mesh can tell to be wrong; "none" alone is the empty set.
/// Errors: kInvalidArgument, for an empty name or one that no attribute can have.
Result<AttributeNames> ParseAttributes(std::string_view list);

}  // namespace strata::server
