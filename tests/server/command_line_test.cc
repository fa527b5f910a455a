#include "server/command_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "server/option_table.h"
#include "tests/support/read_text.h"

namespace strata::server {
namespace {

using testing::AllOf;
using testing::HasSubstr;

Result<Command> Parse(const std::string& line) {
  std::istringstream words(line);
  std::vector<std::string> arguments;
  for (std::string word; words >> word;) arguments.push_back(word);
  return ParseCommandLine(arguments);
}

/// The command of a line that is right.
SampleCommand Sample(const std::string& options) {
  auto command = Parse("sample in.ply -o out.drc " + options);
  if (!command) {
    ADD_FAILURE() << options << ": " << command.error().message;
    return {};
  }
  return std::get<SampleCommand>(*command);
}

/// The message of a line that is wrong.
std::string Refusal(const std::string& line) {
  const auto command = Parse(line);
  if (command) return "accepted";
  EXPECT_EQ(command.error().code, ErrorCode::kInvalidArgument) << line;
  return command.error().message;
}
std::string SampleRefusal(const std::string& options) {
  return Refusal("sample in.ply -o out.drc " + options);
}

// --- One test for each documented option and its default -----------------------------------------

TEST(OptionInput, IsTheFirstPlainWord) {
  EXPECT_EQ(Sample("").input, "in.ply");
  EXPECT_EQ(std::get<SampleCommand>(*Parse("sample - -o x.ply")).input, "-");
  EXPECT_THAT(Refusal("sample -o out.drc"), HasSubstr("INPUT is missing"));
  EXPECT_THAT(SampleRefusal("more.ply"), HasSubstr("second input 'more.ply'"));
}

TEST(OptionOutput, IsNeeded) {
  EXPECT_EQ(Sample("").output, "out.drc");
  EXPECT_EQ(std::get<SampleCommand>(*Parse("sample in.ply --output=x.xyz")).output, "x.xyz");
  EXPECT_THAT(Refusal("sample in.ply"), HasSubstr("-o OUTPUT is missing"));
}

TEST(OptionResolution, DefaultsTo128) {
  EXPECT_EQ(std::get<Resolution>(Sample("").options.lattice).n, 128u);
  EXPECT_EQ(std::get<Resolution>(Sample("--resolution 1").options.lattice).n, 1u);
  EXPECT_EQ(std::get<Resolution>(Sample("--resolution 536870912").options.lattice).n, 1u << 29);
  for (const char* bad : {"0", "536870913", "-1", "1.5", "x", "99999999999999999999"}) {
    EXPECT_THAT(SampleRefusal(std::string("--resolution ") + bad),
                AllOf(HasSubstr("--resolution: found '" + std::string(bad)),
                      HasSubstr("1 to 536870912 (default 128)")));
  }
}

TEST(OptionVoxelSize, IsAnyPositiveNumber) {
  EXPECT_EQ(std::get<VoxelSize>(Sample("--voxel-size 0.02").options.lattice).edge, 0.02);
  EXPECT_EQ(std::get<VoxelSize>(Sample("--voxel-size 1e9").options.lattice).edge, 1e9);
  for (const char* bad : {"0", "-0.5", "nan", "inf", "-inf", "1e999", "2m"}) {
    EXPECT_THAT(SampleRefusal(std::string("--voxel-size ") + bad), HasSubstr("from 1e-60"));
  }
}

TEST(OptionMethod, DefaultsToStratified) {
  EXPECT_EQ(Sample("").options.method, Method::kStratified);
  EXPECT_EQ(Sample("--method stratified").options.method, Method::kStratified);
  EXPECT_EQ(Sample("--method uniform").options.method, Method::kUniform);
  EXPECT_THAT(SampleRefusal("--method random"),
              HasSubstr("--method: found 'random', expected stratified or uniform"));
  for (const char* line : {"scan in.ply --share 0/1 -o a.run", "merge a.run -o a.ply"}) {
    EXPECT_THAT(Refusal(std::string(line) + " --method uniform"),
                HasSubstr("unknown option '--method'"));
  }
}

TEST(OptionCount, IsOfTheUniformMethodAlone) {
  EXPECT_EQ(Sample("--method uniform").options.count, 0u) << "as many as stratified keeps";
  EXPECT_EQ(Sample("--method uniform --count 1").options.count, 1u);
  EXPECT_EQ(Sample("--method uniform --count 1099511627776").options.count, kMaxCount);
  for (const char* bad : {"0", "1099511627777", "-3", "1.5", "many"}) {
    EXPECT_THAT(SampleRefusal(std::string("--method uniform --count ") + bad),
                HasSubstr("--count: found '" + std::string(bad) + "', expected a whole number"));
  }
  EXPECT_THAT(SampleRefusal("--count 5"), HasSubstr("an option of --method uniform"));
  EXPECT_THAT(SampleRefusal("--count 5 --method stratified"), HasSubstr("--method uniform"));
}

TEST(OptionCount, ExcludesWhatDecidesTheNumberWithoutIt) {
  for (const char* option : {"--lambda 3", "--min-distance 0.7", "--integrator exact"}) {
    EXPECT_EQ(Sample(std::string("--method uniform ") + option).options.method, Method::kUniform);
    EXPECT_THAT(SampleRefusal(std::string("--method uniform --count 5 ") + option),
                HasSubstr("--count excludes --lambda, --min-distance and --integrator"));
  }
  EXPECT_EQ(Sample("--method uniform --count 5 --voxel-size 2 --seed 3").options.count, 5u);
}

TEST(OptionHeight, RunsFrom1To30) {
  EXPECT_EQ(std::get<Height>(Sample("--height 7").options.lattice).h, 7u);
  for (const char* bad : {"0", "31", "-7", "7.0"}) {
    EXPECT_THAT(SampleRefusal(std::string("--height ") + bad), HasSubstr("1 to 30"));
  }
}

TEST(OptionsWhere, ExcludeEachOther) {
  for (const char* two : {"--resolution 9 --height 3", "--resolution 9 --voxel-size 1",
                          "--voxel-size 1 --height 3"}) {
    EXPECT_THAT(SampleRefusal(two), HasSubstr("exclude each other"));
  }
}

TEST(OptionLambda, DefaultsTo5) {
  EXPECT_EQ(Sample("").options.lambda, 5);
  EXPECT_EQ(Sample("--lambda 0").options.lambda, 0);
  EXPECT_EQ(Sample("--lambda 500").options.lambda, 500);
  for (const char* bad : {"-1", "501", "nan", "inf", "five", ""}) {
    EXPECT_THAT(SampleRefusal(std::string("--lambda=") + bad), HasSubstr("--lambda: "));
  }
  EXPECT_THAT(SampleRefusal("--lambda nan"), HasSubstr("0 to 500 (default 5)"));
}

TEST(OptionMinDistance, DefaultsToHalfAnEdge) {
  EXPECT_EQ(Sample("").options.min_distance, 0.5);
  EXPECT_EQ(Sample("--min-distance 0").options.min_distance, 0);
  EXPECT_EQ(Sample("--min-distance 4").options.min_distance, 4);
  EXPECT_THAT(SampleRefusal("--min-distance 4.1"), HasSubstr("0 to 4 (default 0.5)"));
}

TEST(OptionSeed, DefaultsTo0AndTakes64Bits) {
  EXPECT_EQ(Sample("").options.seed, 0u);
  EXPECT_EQ(Sample("--seed 18446744073709551615").options.seed, ~std::uint64_t{0});
  EXPECT_THAT(SampleRefusal("--seed 18446744073709551616"), HasSubstr("(default 0)"));
  EXPECT_THAT(SampleRefusal("--seed -1"), HasSubstr("found '-1'"));
  EXPECT_THAT(SampleRefusal("--seed"), HasSubstr("--seed"));
  EXPECT_THAT(SampleRefusal("--seed 1 --seed 2"), HasSubstr("--seed"));
}

TEST(OptionIntegrator, DefaultsToExact) {
  EXPECT_EQ(Sample("").options.integrator, Integrator::kExact);
  EXPECT_EQ(Sample("--integrator exact").options.integrator, Integrator::kExact);
  EXPECT_EQ(Sample("--integrator subdivide").options.integrator, Integrator::kSubdivide);
  EXPECT_THAT(SampleRefusal("--integrator both"), HasSubstr("exact or subdivide"));
}

TEST(OptionThreads, DefaultsToAll) {
  EXPECT_EQ(Sample("").options.threads, 0);
  EXPECT_EQ(Sample("--threads 8").options.threads, 8);
  for (const char* bad : {"-1", "1025", "all"}) {
    EXPECT_THAT(SampleRefusal(std::string("--threads ") + bad), HasSubstr("0 to 1024"));
  }
}

TEST(OptionBatchSize, DefaultsTo2048) {
  EXPECT_EQ(Sample("").options.batch_size, 2048u);
  EXPECT_EQ(Sample("--batch-size 1").options.batch_size, 1u);
  for (const char* bad : {"0", "1048577"}) {
    EXPECT_THAT(SampleRefusal(std::string("--batch-size ") + bad), HasSubstr("1 to 1048576"));
  }
}

TEST(OptionSimd, DefaultsToAuto) {
  EXPECT_EQ(Sample("").simd, "auto");
  EXPECT_EQ(Sample("--simd sse4").simd, "sse4");
}

TEST(OptionFormat, FollowsTheSuffix) {
  const auto format_of = [](const std::string& line) {
    return std::get<SampleCommand>(*Parse("sample in.ply " + line)).format;
  };
  EXPECT_EQ(format_of("-o a.drc"), io::SampleFormat::kDraco);
  EXPECT_EQ(format_of("-o a.ply"), io::SampleFormat::kPly);
  EXPECT_EQ(format_of("-o a.xyz"), io::SampleFormat::kXyz);
  EXPECT_EQ(format_of("-o a.npz"), io::SampleFormat::kNpz);
  EXPECT_EQ(format_of("-o a.vdb"), io::SampleFormat::kVdb);
  EXPECT_EQ(format_of("-o a.dat --format npz"), io::SampleFormat::kNpz);
  EXPECT_EQ(format_of("-o a.ply --format xyz"), io::SampleFormat::kXyz);
  EXPECT_THAT(Refusal("sample in.ply -o a.dat"),
              HasSubstr(".drc, .ply, .xyz, .npz, .csv, .glb or .vdb"));
  EXPECT_THAT(Refusal("sample in.ply -o -"), HasSubstr("--format is needed"));
  EXPECT_THAT(SampleRefusal("--format obj"), HasSubstr("drc, ply, xyz, npz, csv, glb or vdb"));
}

TEST(OptionAttributes, DefaultsToNormal) {
  EXPECT_EQ(Sample("").options.attributes, AttributeSet{kNormal});
  EXPECT_EQ(Sample("--attributes none").options.attributes, AttributeSet{0});
  EXPECT_EQ(Sample("--attributes area,cell").options.attributes, AttributeSet{kArea | kCell});
  EXPECT_EQ(Sample("--attributes normal,triangle,barycentric,cell,area,weight").options.attributes,
            kAllAttributes);
  for (const char* bad : {"a/b", "normal,none", "normal,", ",area"}) {
    EXPECT_THAT(SampleRefusal(std::string("--attributes ") + bad),
                HasSubstr("normal, triangle, barycentric, cell, area, weight and names"));
  }
}

TEST(OptionAttributes, LeavesOtherNamesToTheMesh) {
  const SampleOptions some = Sample("--attributes color,area,label,color").options;
  EXPECT_EQ(some.attributes, AttributeSet{kArea});
  EXPECT_EQ(some.mesh_attributes, (std::vector<std::string>{"color", "label"}));
  const SampleOptions all = Sample("--attributes all").options;
  EXPECT_EQ(all.attributes, kAllAttributes);
  EXPECT_EQ(all.mesh_attributes, std::vector<std::string>{"all"});
  EXPECT_THAT(Refusal("scan in.ply --share 0/2 -o a.run --attributes color"),
              HasSubstr("`strata sample` alone"));
  EXPECT_THAT(Refusal("merge a.run -o a.ply --attributes all"), HasSubstr("`strata sample` alone"));
}

TEST(OptionNormals, DefaultsToFace) {
  EXPECT_FALSE(Sample("").options.vertex_normals);
  EXPECT_FALSE(Sample("--normals face").options.vertex_normals);
  EXPECT_TRUE(Sample("--normals vertex").options.vertex_normals);
  EXPECT_THAT(SampleRefusal("--normals flat"), HasSubstr("vertex or face (default face)"));
  EXPECT_THAT(SampleRefusal("--normals vertex --attributes area"), HasSubstr("add normal"));
}

TEST(OptionPositionError, DefaultsTo1PercentOfTheEdge) {
  EXPECT_EQ(Sample("").position_error, 0.01);
  EXPECT_EQ(Sample("--position-error 1").position_error, 1);
  for (const char* bad : {"0", "1.01", "1e-10", "nan"}) {
    EXPECT_THAT(SampleRefusal(std::string("--position-error ") + bad),
                HasSubstr("1e-9 to 1 (default 0.01)"));
  }
}

TEST(OptionTileSamples, IsFourMillionByDefault) {
  EXPECT_EQ(Sample("").tile_samples, 4'000'000u);
  EXPECT_EQ(Sample("--tile-samples 1").tile_samples, 1u);
  EXPECT_EQ(Sample("--tile-samples 536870911").tile_samples, 536'870'911u);
  for (const char* bad : {"0", "536870912", "-1", "1e6", "many"}) {
    EXPECT_THAT(SampleRefusal(std::string("--tile-samples ") + bad),
                HasSubstr("1 to 536870911 (default 4000000)"));
  }
}

TEST(OptionStrict, IsOffByDefault) {
  EXPECT_FALSE(Sample("").options.strict);
  EXPECT_TRUE(Sample("--strict").options.strict);
}

TEST(OptionQuiet, IsOffByDefault) {
  EXPECT_FALSE(Sample("").quiet);
  EXPECT_TRUE(Sample("--quiet").quiet);
}

TEST(OptionAssimp, IsOffByDefault) {
  EXPECT_FALSE(Sample("").assimp);
  EXPECT_TRUE(Sample("--assimp").assimp);
}

TEST(OptionSummary, IsOffByDefault) {
  EXPECT_FALSE(Sample("").summary.has_value());
  EXPECT_EQ(Sample("--summary s.json").summary, "s.json");
  EXPECT_EQ(Sample("--summary -").summary, "-");
  EXPECT_THAT(Refusal("sample in.ply -o - --format ply --summary -"), HasSubstr("would mix"));
}

TEST(OptionPicture, IsOffByDefault) {
  EXPECT_FALSE(Sample("").picture.has_value());
  EXPECT_EQ(Sample("--picture p.png").picture, "p.png");
  EXPECT_THAT(SampleRefusal("--picture -"), HasSubstr("the name of a file"));
}

TEST(CommandInfo, TakesAMeshAndJson) {
  const auto info = std::get<InfoCommand>(*Parse("info in.ply"));
  EXPECT_EQ(info.input, "in.ply");
  EXPECT_FALSE(info.json);
  EXPECT_TRUE(std::get<InfoCommand>(*Parse("info --json -")).json);
  EXPECT_THAT(Refusal("info"), HasSubstr("MESH is missing"));
}

// --- Mistakes, and help --------------------------------------------------------------------------

TEST(CommandLine, SuggestsTheNearestName) {
  EXPECT_THAT(SampleRefusal("--lamda 5"), HasSubstr("did you mean '--lambda'?"));
  EXPECT_THAT(SampleRefusal("--resolutoin=5"), HasSubstr("did you mean '--resolution'?"));
  EXPECT_THAT(Refusal("smaple in.ply"), HasSubstr("did you mean 'sample'?"));
  EXPECT_THAT(Refusal("info in.ply --jsn"), HasSubstr("did you mean '--json'?"));
  EXPECT_THAT(SampleRefusal("--frobnicate"), HasSubstr("see strata sample --help"));
  EXPECT_THAT(Refusal(""), HasSubstr("a command is missing"));
}

std::string Help(const std::string& line) { return std::get<ShowText>(*Parse(line)).text; }

TEST(CommandLine, VersionIsOneLine) {
  EXPECT_THAT(Help("--version"), testing::MatchesRegex("strata [0-9]+\\.[0-9]+\\.[0-9]+\n"));
}

TEST(CommandLine, HelpNamesEveryOptionAndExitCode) {
  const std::string help = Help("sample --help");
  for (const OptionRow& row : SampleOptionRows()) EXPECT_THAT(help, HasSubstr(row.names));
  for (const FlagRow& row : SampleFlagRows()) EXPECT_THAT(help, HasSubstr(row.names));
  EXPECT_THAT(help, HasSubstr("Examples:"));
  EXPECT_THAT(help, HasSubstr("Exit codes:"));
  EXPECT_THAT(Help("--help"), AllOf(HasSubstr("sample"), HasSubstr("info"), HasSubstr("Exit")));
  EXPECT_THAT(Help("info --help"), HasSubstr("--json"));
}

TEST(CommandLine, HelpStatesTheRangesThatAreHeld) {
  const std::string help = Help("sample --help");
  // What a refusal says between "from" and "(default", and in help words, "N to M".
  for (const char* option : {"--resolution", "--height", "--lambda", "--min-distance", "--seed",
                             "--position-error", "--threads", "--batch-size"}) {
    const std::string refusal = SampleRefusal(std::string(option) + " x");
    const std::size_t begin = refusal.find("from ") + 5;
    const std::string range = refusal.substr(begin, refusal.find(" (", begin) - begin);
    EXPECT_THAT(help, HasSubstr(range)) << option;
  }
}

TEST(CommandLine, HelpFitsInAHundredColumns) {
  for (const char* line : {"--help", "sample --help", "info --help"}) {
    std::istringstream lines(Help(line));
    for (std::string text; std::getline(lines, text);) EXPECT_LE(text.size(), 100u) << text;
  }
}

TEST(CommandLine, ReadmeNamesEveryOption) {
  const std::string readme = test::ReadText(STRATA_SOURCE_DIR "/README.md");
  const auto long_name = [](const std::string& names) { return names.substr(names.find("--")); };
  for (const OptionRow& row : SampleOptionRows()) {
    EXPECT_THAT(readme, HasSubstr("`" + long_name(row.names) + " "));
  }
  for (const FlagRow& row : SampleFlagRows()) {
    EXPECT_THAT(readme, HasSubstr("`" + long_name(row.names) + "`"));
  }
}

}  // namespace
}  // namespace strata::server
