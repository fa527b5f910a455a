#include "server/command_line.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <memory>
#include <utility>
#include <vector>

#include "core/version.h"
#include "server/nearest_name.h"
#include "server/option_table.h"
#include "server/parse_number.h"

namespace strata::server {
namespace {

tl::unexpected<Error> Refuse(std::string message) {
  return Fail(ErrorCode::kInvalidArgument, std::move(message));
}

// --- The grammar: what CLI11 knows ---------------------------------------------------------------

/// CLI11's help with the usage line spelled out and single blank lines between the groups.
class HelpFormatter : public CLI::Formatter {
 public:
  std::string make_usage(const CLI::App* app, std::string) const override {
    if (app->get_name() == "sample") return "\nUsage: strata sample INPUT -o OUTPUT [options]\n";
    if (app->get_name() == "scan") {
      return "\nUsage: strata scan MESH --share I/N -o PART.run [options]\n";
    }
    if (app->get_name() == "merge") {
      return "\nUsage: strata merge PART.run... -o OUTPUT [options]\n";
    }
    if (app->get_name() == "info") return "\nUsage: strata info MESH [--json] [--assimp]\n";
    return "\nUsage: strata sample INPUT -o OUTPUT [options]\n"
           "       strata scan MESH --share I/N -o PART.run [options]\n"
           "       strata merge PART.run... -o OUTPUT [options]\n"
           "       strata info MESH [--json] [--assimp]\n"
#ifdef STRATA_SERVICE
           "       strata serve [options]\n"
           "       strata worker [options]\n"
           "       strata key NAME [--role full|read]\n"
           "       strata health [URL]\n"
           "       strata batch REPO -o OUT [options]\n"
           "       strata report OUT... [options]\n"
#endif
           "       strata COMMAND --help\n";
  }
  std::string make_help(const CLI::App* app, std::string name,
                        CLI::AppFormatMode mode) const override {
    const std::string text = CLI::Formatter::make_help(app, std::move(name), mode);
    return CLI::detail::find_and_replace(text, "\n\n\n", "\n\n");
  }
};

std::unique_ptr<CLI::App> MakeApp() {
  auto app = std::make_unique<CLI::App>(
      "Strata draws stratified point samples from triangle meshes.", "strata");
  auto formatter = std::make_shared<HelpFormatter>();
  formatter->column_width(27);
  app->formatter(formatter);
  app->set_help_flag("-h,--help", "Print this and stop.");
  app->set_version_flag("--version", "strata " + std::string(kVersion),
                        "Print the version and stop.");
  app->allow_extras();
  app->footer(ExamplesText() + '\n' + ExitCodesText());
  return app;
}

void AddOptional(CLI::App& app, const char* names, std::optional<std::string>& into,
                 const char* value, const char* group, const char* help) {
  app.add_option_function<std::string>(
         names, [&into](const std::string& text) { into = text; }, help)
      ->option_text(value)
      ->type_name(value)
      ->group(group);
}

void AddRows(CLI::App& app, Subcommand command, RawSample& raw) {
  for (const OptionRow& row : SampleOptionRows()) {
    if (!Takes(command, row.names)) continue;
    AddOptional(app, row.names, raw.*row.into, row.value, row.group, row.help);
  }
  for (const FlagRow& row : SampleFlagRows()) {
    if (!Takes(command, row.names)) continue;
    app.add_flag(row.names, raw.*row.into, row.help)->disable_flag_override()->group(row.group);
  }
}

CLI::App* AddScan(CLI::App& app, RawSample& raw) {
  CLI::App* scan = app.add_subcommand("scan", "Scan one share of a mesh into a partial.");
  scan->allow_extras();
  scan->footer(ExitCodesText());
  AddOptional(*scan, "MESH", raw.input, "", "Options", "Mesh file; every share names the same.");
  AddOptional(*scan, "--share", raw.share, "I/N", "Options",
              "Which of N shares of the triangles, I from 0 to N-1. N up to\n"
              "1048576. Required.");
  AddOptional(*scan, "--lattice", raw.lattice, "X,Y,Z,E", "Where",
              "Origin and edge that --resolution or --height come to, as a\n"
              "summary or an earlier share says: saves finding them again.");
  AddRows(*scan, Subcommand::kScan, raw);
  return scan;
}

CLI::App* AddMerge(CLI::App& app, RawSample& raw) {
  CLI::App* merge =
      app.add_subcommand("merge", "Merge partials into samples, or into one partial.");
  merge->allow_extras();
  merge->footer(ExitCodesText());
  merge
      ->add_option("PART", raw.parts,
                   "Partials of one job, in any order. An OUTPUT that ends in .run\n"
                   "is a partial again; else no share may be missing.")
      ->option_text("")
      ->group("Options");
  AddOptional(*merge, "--region", raw.region, "J/R", "Options",
              "Write only the J-th of R parts, J from 0 to R-1, of a drc folder:\n"
              "R processes, in any order or at once, write it together, with\n"
              "the tiles of a single merge. It appears when all are done. R up\n"
              "to 65536.");
  AddRows(*merge, Subcommand::kMerge, raw);
  return merge;
}

CLI::App* AddSample(CLI::App& app, RawSample& raw) {
  CLI::App* sample = app.add_subcommand("sample", "Sample a mesh file.");
  sample->allow_extras();
  sample->footer(ExamplesText() + '\n' + ExitCodesText());
  AddOptional(*sample, "INPUT", raw.input, "", "Options",
              "Mesh file: PLY, OBJ, STL, OFF, glTF, GLB, Draco or 3MF, also as\n"
              ".gz, .zst or in a .zip; told by its content. - is standard input.");
  AddRows(*sample, Subcommand::kSample, raw);
  return sample;
}

struct RawInfo {
  std::optional<std::string> input;
  bool json = false, assimp = false;
};

CLI::App* AddInfo(CLI::App& app, RawInfo& raw) {
  CLI::App* info = app.add_subcommand("info", "Print what a mesh file holds.");
  info->allow_extras();
  info->footer(ExitCodesText());
  AddOptional(*info, "MESH", raw.input, "", "Options", "Mesh file; - is standard input.");
  info->add_flag("--json", raw.json, "Print JSON instead of text.");
  info->add_flag("--assimp", raw.assimp, "Let assimp read formats that Strata does not.");
  return info;
}

/// An error for the first argument that nothing took.
Result<void> RefuseExtras(const CLI::App& app, const CLI::App* command) {
  const std::vector<std::string> extras = command ? command->remaining() : app.remaining();
  if (extras.empty()) return {};
  const auto dashed = std::ranges::find_if(extras, [](auto& e) { return e.starts_with("-"); });
  const std::string& found = dashed != extras.end() ? *dashed : extras.front();
  if (command && dashed == extras.end()) {
    return Refuse("found a second input '" + found + "', expected one");
  }
  std::vector<std::string> names = {"sample", "scan", "merge", "info", "--help", "--version"};
#ifdef STRATA_SERVICE
  names.insert(names.end(), {"serve", "worker", "key", "health", "batch", "report"});
#endif
  for (const CLI::Option* option : command ? command->get_options() : app.get_options()) {
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  }
  const std::string typed = found.substr(0, found.find('='));
  const std::string meant = NearestName(typed, names);
  const std::string name = command ? "strata " + command->get_name() : "strata";
  return Refuse((dashed != extras.end() ? "unknown option '" : "unknown command '") + typed +
                "'; " +
                (meant.empty() ? "see " + name + " --help" : "did you mean '" + meant + "'?"));
}

// --- The values: from texts to a command ---------------------------------------------------------

constexpr NumberRange<std::uint32_t> kResolutionRange = {
    "--resolution", 1, kMaxResolution, "a whole number from 1 to 536870912 (default 128)"};
constexpr NumberRange<double> kVoxelSizeRange = {
    "--voxel-size", kMinEdge, kMaxEdge,
    "a number from 1e-60 to 1e60, in world units (default: --resolution 128 instead)"};
constexpr NumberRange<std::uint32_t> kHeightRange = {
    "--height", 1, kMaxHeight, "a whole number from 1 to 30 (default: --resolution 128 instead)"};
constexpr NumberRange<std::uint64_t> kCountRange = {
    "--count", 1, kMaxCount,
    "a whole number from 1 to 1099511627776 (default as many as the stratified method keeps)"};
constexpr NumberRange<double> kLambdaRange = {"--lambda", 0, kMaxLambda,
                                              "a number from 0 to 500 (default 5)"};
constexpr NumberRange<double> kMinDistanceRange = {
    "--min-distance", 0, 4, "a fraction of the edge from 0 to 4 (default 0.5)"};
constexpr NumberRange<std::uint64_t> kSeedRange = {
    "--seed", 0, ~std::uint64_t{0}, "a whole number from 0 to 18446744073709551615 (default 0)"};
constexpr NumberRange<double> kPositionErrorRange = {
    "--position-error", 1e-9, 1, "a fraction of the edge from 1e-9 to 1 (default 0.01)"};
constexpr NumberRange<std::uint64_t> kTileSamplesRange = {
    "--tile-samples", 1, io::kMostTileSamples,
    "a whole number from 1 to 536870911 (default 4000000)"};
constexpr NumberRange<int> kThreadsRange = {
    "--threads", 0, 1024, "a whole number from 0 to 1024 (default 0, all processors)"};
constexpr NumberRange<std::size_t> kBatchSizeRange = {
    "--batch-size", 1, std::size_t{1} << 20, "a whole number from 1 to 1048576 (default 2048)"};

/// Turns texts into values; keeps the first error and ignores what comes after it.
class Converter {
 public:
  template <class T, class Into>
  void Number(const std::optional<std::string>& text, const NumberRange<T>& range, Into& into) {
    if (!text || !outcome_) return;
    const Result<T> value = ParseNumber(*text, range);
    if (!value) {
      outcome_ = Forward(value);
    } else {
      into = *value;
    }
  }
  /// `convert` maps a text to Result<T>.
  template <class T, class Convert>
  void Text(const std::optional<std::string>& text, T& into, Convert convert) {
    if (!text || !outcome_) return;
    Result<T> value = convert(*text);
    if (!value) {
      outcome_ = Forward(value);
    } else {
      into = *std::move(value);
    }
  }
  void Require(bool holds, std::string message) {
    if (outcome_ && !holds) outcome_ = Refuse(std::move(message));
  }
  const Result<void>& outcome() const { return outcome_; }

 private:
  Result<void> outcome_;
};

Result<Method> ParseMethod(std::string_view name) {
  if (name == "stratified") return Method::kStratified;
  if (name == "uniform") return Method::kUniform;
  return Refuse("--method: found '" + std::string(name) +
                "', expected stratified or uniform (default stratified)");
}

Result<Integrator> ParseIntegrator(std::string_view name) {
  if (name == "exact") return Integrator::kExact;
  if (name == "subdivide") return Integrator::kSubdivide;
  return Refuse("--integrator: found '" + std::string(name) +
                "', expected exact or subdivide (default exact)");
}

Result<io::SampleFormat> ParseFormat(std::string_view name) {
  if (const auto format = io::SampleFormatFromName(name)) return *format;
  return Refuse("--format: found '" + std::string(name) +
                "', expected drc, ply, xyz, npz, csv, glb or vdb (default: from OUTPUT's suffix)");
}

Result<io::SampleFormat> FormatOfOutput(const std::string& output) {
  if (output == "-") return Refuse("--format is needed when OUTPUT is standard output");
  if (const auto format = io::SampleFormatFromPath(output)) return *format;
  return Refuse(
      "-o: found '" + output +
      "', expected a name that ends in .drc, .ply, .xyz, .npz, .csv, .glb or .vdb, or --format");
}

void ConvertWhere(const RawSample& raw, Converter& convert, LatticeSpec& lattice) {
  convert.Require(
      raw.resolution.has_value() + raw.voxel_size.has_value() + raw.height.has_value() <= 1,
      "--resolution, --voxel-size and --height exclude each other: give one of them");
  Resolution resolution;
  VoxelSize voxel_size;
  Height height;
  convert.Number(raw.resolution, kResolutionRange, resolution.n);
  convert.Number(raw.voxel_size, kVoxelSizeRange, voxel_size.edge);
  convert.Number(raw.height, kHeightRange, height.h);
  if (raw.voxel_size) {
    lattice = voxel_size;
  } else if (raw.height) {
    lattice = height;
  } else {
    lattice = resolution;
  }
}

void ConvertMethod(const RawSample& raw, Converter& convert, SampleOptions& options) {
  convert.Text(raw.method, options.method, ParseMethod);
  convert.Number(raw.count, kCountRange, options.count);
  convert.Require(
      !raw.count || options.method == Method::kUniform,
      "--count is an option of --method uniform: how many samples the stratified method "
      "keeps follows from the cells (--resolution, --voxel-size or --height)");
  convert.Require(
      !raw.count || (!raw.lambda && !raw.min_distance && !raw.integrator),
      "--count excludes --lambda, --min-distance and --integrator: with --method uniform "
      "they only decide how many samples there are without it");
}

void ConvertHow(const RawSample& raw, Converter& convert, SampleOptions& options) {
  ConvertMethod(raw, convert, options);
  convert.Number(raw.lambda, kLambdaRange, options.lambda);
  convert.Number(raw.min_distance, kMinDistanceRange, options.min_distance);
  convert.Number(raw.seed, kSeedRange, options.seed);
  convert.Text(raw.integrator, options.integrator, ParseIntegrator);
  convert.Number(raw.threads, kThreadsRange, options.threads);
  convert.Number(raw.batch_size, kBatchSizeRange, options.batch_size);
  options.strict = raw.strict;
}

// As FixNames leaves them: anything else cannot be there.
bool IsAttributeName(std::string_view name) {
  const auto plain = [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '_' || c == '.' || c == '-';
  };
  return !name.empty() && name != "none" && std::ranges::all_of(name, plain);
}

Result<bool> ParseNormals(std::string_view name) {
  if (name == "vertex") return true;
  if (name == "face") return false;
  return Refuse("--normals: found '" + std::string(name) +
                "', expected vertex or face (default face)");
}

Result<std::uint64_t> ParseMemory(std::string_view text) {
  const auto bytes = ParseSize(text);
  if (bytes && *bytes >= kLeastMemory) return *bytes;
  return Refuse("--memory: found '" + std::string(text) +
                "', expected a size of 64M or more, such as 512M, 4G or 4294967296 "
                "(default half of what this process may use)");
}

void ConvertPlaces(const RawSample& raw, Converter& convert, SampleCommand& command) {
  convert.Require(raw.input && !raw.input->empty(), "INPUT is missing; - is standard input");
  convert.Require(raw.output && !raw.output->empty(), "-o OUTPUT is missing; - is standard output");
  convert.Require(!(raw.output == "-" && raw.summary == "-"),
                  "-o - and --summary - would mix on standard output: give one of them a file");
  convert.Require(raw.picture != "-", "--picture: found '-', expected the name of a file");
  command.input = raw.input.value_or("");
  command.output = raw.output.value_or("");
  command.summary = raw.summary;
  command.picture = raw.picture;
}

// What all commands have in common.
void ConvertRun(const RawSample& raw, Converter& convert, SampleCommand& command) {
  ConvertWhere(raw, convert, command.options.lattice);
  ConvertHow(raw, convert, command.options);
  AttributeNames names{command.options.attributes, {}};
  convert.Text(raw.attributes, names, ParseAttributes);
  command.options.attributes = names.fixed;
  command.options.mesh_attributes = std::move(names.of_mesh);
  convert.Text(raw.normals, command.options.vertex_normals, ParseNormals);
  convert.Require(!command.options.vertex_normals || (names.fixed & kNormal) != 0,
                  "--normals vertex says which normals are written, but --attributes leaves them "
                  "out; add normal");
  convert.Number(raw.position_error, kPositionErrorRange, command.position_error);
  convert.Number(raw.tile_samples, kTileSamplesRange, command.tile_samples);
  if (raw.memory) convert.Text(raw.memory, command.memory, ParseMemory);
  command.scratch = raw.scratch;
  command.simd = raw.simd.value_or(command.simd);
  command.resume = raw.resume;
  command.quiet = raw.quiet;
  command.assimp = raw.assimp;
}

// Shares and partials give the fixed attributes alone.
void RequireFixedAttributes(Converter& convert, const SampleCommand& job) {
  const auto& names = job.options.mesh_attributes;
  convert.Require(names.empty(),
                  "--attributes: found '" + (names.empty() ? "" : names.front()) +
                      "', expected normal, triangle, barycentric, cell, area and weight: what a "
                      "mesh carries is fetched by `strata sample` alone");
}

// "I/N" with I < N <= most; nothing if it is not.
std::optional<std::pair<std::uint32_t, std::uint32_t>> ParseOneOf(std::string_view text,
                                                                  std::uint32_t most) {
  std::pair<std::uint32_t, std::uint32_t> one;
  const std::size_t slash = std::min(text.find('/'), text.size());
  const auto number = [](std::string_view digits, std::uint32_t& into) {
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), into);
    return error == std::errc() && end == digits.data() + digits.size();
  };
  const bool good = slash < text.size() && number(text.substr(0, slash), one.first) &&
                    number(text.substr(slash + 1), one.second);
  if (good && one.second <= most && one.first < one.second) return one;
  return std::nullopt;
}

Result<Share> ParseShare(std::string_view text) {
  if (const auto one = ParseOneOf(text, 1u << 20)) return Share{one->first, one->second};
  return Refuse("--share: found '" + std::string(text) +
                "', expected I/N with I from 0 to N-1 and N from 1 to 1048576");
}

Result<Region> ParseRegion(std::string_view text) {
  if (const auto one = ParseOneOf(text, 1u << 16)) return Region{one->first, one->second};
  return Refuse("--region: found '" + std::string(text) +
                "', expected J/R with J from 0 to R-1 and R from 1 to 65536");
}

Result<Lattice> ParseLattice(std::string_view text) {
  double numbers[4];
  std::string_view rest = text;
  bool good = true;
  for (int i = 0; i < 4 && good; ++i) {
    const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), numbers[i]);
    good = error == std::errc() && std::isfinite(numbers[i]);
    rest.remove_prefix(static_cast<std::size_t>(end - rest.data()));
    if (i < 3) {
      good = good && rest.starts_with(',');
      rest.remove_prefix(good ? 1 : 0);
    }
  }
  if (good && rest.empty() && numbers[3] >= kMinEdge && numbers[3] <= kMaxEdge) {
    return Lattice{{numbers[0], numbers[1], numbers[2]}, numbers[3]};
  }
  return Refuse("--lattice: found '" + std::string(text) +
                "', expected X,Y,Z,E: an origin and an edge in world units");
}

Result<Command> ConvertScan(const RawSample& raw) {
  ScanCommand command;
  Converter convert;
  ConvertPlaces(raw, convert, command.job);
  convert.Require(raw.input != "-", "MESH: found '-', expected a file, which all shares can read");
  convert.Require(raw.share.has_value(), "--share I/N is missing");
  ConvertRun(raw, convert, command.job);
  RequireFixedAttributes(convert, command.job);
  convert.Text(raw.share, command.share, ParseShare);
  if (raw.lattice) convert.Text(raw.lattice, command.lattice, ParseLattice);
  if (!convert.outcome()) return Forward(convert.outcome());
  return Command(std::move(command));
}

void ConvertRegion(const RawSample& raw, Converter& convert, MergeCommand& command) {
  if (!raw.region) return;
  Region region;
  convert.Text(raw.region, region, ParseRegion);
  command.region = region;
  convert.Require(!command.to_partial && command.job.format == io::SampleFormat::kDraco &&
                      command.job.output != "-",
                  "--region needs a drc OUTPUT with a name, which becomes a folder: any other "
                  "format is one file, and several processes cannot write that");
  convert.Require(!raw.picture && !raw.summary,
                  "--picture and --summary are of the whole output, and --region sees one part");
}

Result<Command> ConvertMerge(RawSample raw) {
  MergeCommand command;
  Converter convert;
  convert.Require(!raw.parts.empty(), "PART is missing: name the partials to merge");
  if (!raw.parts.empty()) raw.input = raw.parts.front();
  ConvertPlaces(raw, convert, command.job);
  ConvertRun(raw, convert, command.job);
  RequireFixedAttributes(convert, command.job);
  command.inputs = raw.parts;
  command.job.input = "-";  // Its places are the inputs.
  command.to_partial = !raw.format && raw.output && raw.output->ends_with(".run");
  if (raw.format) convert.Text(raw.format, command.job.format, ParseFormat);
  if (!raw.format && !command.to_partial) {
    convert.Text(raw.output, command.job.format, FormatOfOutput);
  }
  ConvertRegion(raw, convert, command);
  if (!convert.outcome()) return Forward(convert.outcome());
  return Command(std::move(command));
}

Result<Command> ConvertInfo(const RawInfo& raw) {
  if (!raw.input || raw.input->empty()) return Refuse("MESH is missing; - is standard input");
  return Command(InfoCommand{*raw.input, raw.json, raw.assimp});
}

}  // namespace

std::vector<CommandText> DescribeCommands() {
  RawSample raw;
  RawInfo raw_info;
  const auto app = MakeApp();
  std::vector<CommandText> all = {Describe(*app, "")};
  for (const CLI::App* const command :
       {AddSample(*app, raw), AddScan(*app, raw), AddMerge(*app, raw), AddInfo(*app, raw_info)}) {
    all.push_back(Describe(*command, command->get_name()));
  }
  return all;
}

Result<SampleCommand> CheckSample(const RawSample& raw) {
  SampleCommand command;
  Converter convert;
  ConvertPlaces(raw, convert, command);
  ConvertRun(raw, convert, command);
  if (raw.format) convert.Text(raw.format, command.format, ParseFormat);
  if (!raw.format) convert.Text(raw.output, command.format, FormatOfOutput);
  if (!convert.outcome()) return Forward(convert.outcome());
  return command;
}

Result<std::uint64_t> ParseSize(std::string_view text) {
  const std::string_view all = text;
  double factor = 1;
  if (text.ends_with("iB")) {
    text.remove_suffix(2);
  } else if (text.ends_with('B')) {
    text.remove_suffix(1);
  }
  constexpr std::string_view kUnits = "KMGT";
  if (const auto unit = text.empty() ? kUnits.npos : kUnits.find(text.back());
      unit != kUnits.npos) {
    factor = std::ldexp(1.0, 10 * static_cast<int>(unit + 1));
    text.remove_suffix(1);
  }
  double number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  const double bytes = number * factor;
  if (error != std::errc() || end != text.data() + text.size() || !(bytes >= 0 && bytes < 0x1p63)) {
    return Refuse("found '" + std::string(all) + "', expected a size such as 512M or 4G");
  }
  return static_cast<std::uint64_t>(bytes);
}

Result<AttributeNames> ParseAttributes(std::string_view list) {
  AttributeNames names;
  if (list == "none") return names;
  for (std::size_t begin = 0; begin <= list.size();) {
    const std::size_t end = std::min(list.find(',', begin), list.size());
    const std::string_view name = list.substr(begin, end - begin);
    const auto* const found = std::ranges::find(kAttributeNames, name);
    if (found != kAttributeNames.end()) {
      names.fixed |= AttributeSet{1} << (found - kAttributeNames.begin());
    } else if (!IsAttributeName(name)) {
      return Refuse("--attributes: found '" + std::string(name) +
                    "', expected normal, triangle, barycentric, cell, area, weight and names of "
                    "the mesh's attributes with commas between, all, or none (default normal)");
    } else if (std::ranges::find(names.of_mesh, name) == names.of_mesh.end()) {
      names.of_mesh.emplace_back(name);
    }
    if (name == "all") names.fixed = kAllAttributes;
    begin = end + 1;
  }
  return names;
}

Result<Command> ParseCommandLine(std::span<const std::string> arguments) {
  RawSample raw_sample;
  RawInfo raw_info;
  const auto app = MakeApp();
  const CLI::App* const sample = AddSample(*app, raw_sample);
  RawSample raw_scan, raw_merge;
  const CLI::App* const scan = AddScan(*app, raw_scan);
  const CLI::App* const merge = AddMerge(*app, raw_merge);
  const CLI::App* const info = AddInfo(*app, raw_info);
  try {
    // CLI11 takes its vector back to front.
    app->parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
  } catch (const CLI::CallForHelp&) {
    return Command(ShowText{app->help()});
  } catch (const CLI::CallForVersion& version) {
    return Command(ShowText{std::string(version.what()) + '\n'});
  } catch (const CLI::Error& error) {
    return Refuse(error.what());
  }
  const CLI::App* command = nullptr;
  for (const CLI::App* each : {sample, scan, merge, info}) {
    if (each->parsed()) command = each;
  }
  if (auto extras = RefuseExtras(*app, command); !extras) return Forward(extras);
  if (!command) {
    return Refuse("a command is missing, sample, scan, merge or info; see strata --help");
  }
  if (command == scan) return ConvertScan(raw_scan);
  if (command == merge) return ConvertMerge(std::move(raw_merge));
  if (command == info) return ConvertInfo(raw_info);
  auto checked = CheckSample(raw_sample);
  if (!checked) return Forward(checked);
  return Command(*std::move(checked));
}

}  // namespace strata::server
