// The options of `strata sample`: names, groups and help in one table, the texts as they were
// typed.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace strata::server {

/// What stood on the command line, before any of it is judged. Absent options stay empty.
struct RawSample {
  std::optional<std::string> input, output;
  std::vector<std::string> parts;             // Of merge.
  std::optional<std::string> region;          // Of merge.
  std::optional<std::string> share, lattice;  // Of scan.
  std::optional<std::string> resolution, voxel_size, height;
  std::optional<std::string> method, count, lambda, min_distance, seed, integrator;
  std::optional<std::string> format, attributes, normals, position_error, tile_samples, picture,
      summary;
  std::optional<std::string> memory, scratch, threads, simd, batch_size;
  bool strict = false, resume = false, quiet = false, assimp = false;
};

/// The commands that take options from the tables below.
enum class Subcommand { kSample, kScan, kMerge };

/// An option that takes a value.
struct OptionRow {
  const char* names;  ///< As CLI11 takes them: "-o,--output".
  const char* value;  ///< The value's name in the help.
  const char* group;  ///< Heading in the help.
  const char* help;   ///< What it does, unit, range, default; lines of at most 64 characters.
  std::optional<std::string> RawSample::*into;
};

/// An option that takes none.
struct FlagRow {
  const char* names;
  const char* group;
  const char* help;
  bool RawSample::*into;
};

/// In the order of the help. The rows live as long as the program.
std::span<const OptionRow> SampleOptionRows();
std::span<const FlagRow> SampleFlagRows();

/// Whether a command takes the option of these names.
bool Takes(Subcommand command, std::string_view names);

/// Examples and exit codes: what stands under the options of `strata --help` and of each command.
std::string ExamplesText();
std::string ExitCodesText();

}  // namespace strata::server
