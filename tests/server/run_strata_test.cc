// The command from end to end, as a user runs it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/image_maker.h"
#include "tests/support/process.h"
#include "tests/support/shapes.h"

namespace strata::test {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::StartsWith;

Outcome Strata(const std::vector<std::string>& arguments, const std::string& input = "",
               const Child::Setup& setup = {}) {
  return Run(STRATA_BINARY, arguments, input, setup);
}

/// A folder that holds one mesh, and the command run inside it.
class RunStrata : public testing::Test {
 protected:
  RunStrata() { WriteFile(folder / "cube.obj", CubeObj()); }

  std::string In(const std::string& name) const { return folder / name; }
  Outcome Sample(const std::string& output, const std::vector<std::string>& options = {}) const {
    std::vector<std::string> arguments = {"sample", In("cube.obj"), "-o", In(output)};
    arguments.insert(arguments.end(), options.begin(), options.end());
    return Strata(arguments);
  }
  std::string Written(const std::string& output, const std::vector<std::string>& options) const {
    const Outcome outcome = Sample(output, options);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return ReadText(In(output));
  }

  ScratchFolder folder;
};

// --- What comes out ------------------------------------------------------------------------------

TEST_F(RunStrata, WritesEveryFormat) {
  const std::vector<std::pair<std::string, std::string>> formats = {
    {"out.drc", "DRACO"},
    {"out.ply", "ply\n"},
    {"out.npz", "PK"},
    {"out.xyz", ""},
    {"out.glb", "glTF"},
#if !STRATA_SANITIZED
    {"out.vdb", " BDV"},
#endif
  };
  for (const auto& [name, magic] : formats) {
    const std::string bytes = Written(name, {"--resolution", "10"});
    EXPECT_THAT(bytes.substr(0, 8), StartsWith(magic)) << name;
    EXPECT_GT(bytes.size(), 500u) << name;
    // NumPy's strings take four bytes a character.
    const std::string mark = name == "out.npz" ? "provenance.npy" : "surface_hash";
    EXPECT_NE(bytes.find(mark), std::string::npos) << name << " carries no provenance";
  }
}

TEST_F(RunStrata, WritesMoreSamplesThanATileIntoAFolder) {
  const std::vector<std::string> tiled = {"--resolution", "12", "--tile-samples", "100"};
  ASSERT_EQ(Sample("out.drc", tiled).status, 0);
  const json set = json::parse(ReadText(In("out.drc/tileset.json")));
  EXPECT_GT(set["tiles"].size(), 4u);
  for (const json& tile : set["tiles"]) {
    EXPECT_LE(tile["count"], 100);
    EXPECT_THAT(ReadText(In("out.drc/" + std::string(tile["path"]))), StartsWith("DRACO"));
  }
  EXPECT_THAT(Written("out.drc", {"--resolution", "12"}), StartsWith("DRACO")) << "a file again";
  const Outcome piped = Strata({"sample", In("cube.obj"), "-o", "-", "--format", "drc",
                                "--resolution", "12", "--tile-samples", "100"});
  EXPECT_EQ(piped.status, 2);
  EXPECT_THAT(piped.err, HasSubstr("which needs a name"));
  EXPECT_THAT(folder.Names(), ElementsAre("cube.obj", "out.drc"));
}

TEST_F(RunStrata, RefusesAFolderOfOthersAsOutputBeforeItReads) {
  std::filesystem::create_directory(In("mine.drc"));
  Child strata(STRATA_BINARY, {"sample", "-", "-o", In("mine.drc")});
  EXPECT_EQ(strata.Wait(), 8);
  EXPECT_THAT(strata.Err(), HasSubstr("mine.drc"));
}

TEST_F(RunStrata, SuffixAndFormatOptionGiveTheSameBytes) {
  EXPECT_TRUE(Written("a.ply", {"--resolution", "9"}) ==
              Written("a.dat", {"--resolution", "9", "--format", "ply"}));
}

TEST_F(RunStrata, ReadsStandardInputAndWritesStandardOutput) {
  const Outcome piped =
      Strata({"sample", "-", "-o", "-", "--format", "ply", "--resolution", "9"}, CubeObj());
  EXPECT_EQ(piped.status, 0) << piped.err;
  EXPECT_TRUE(piped.out == Written("a.ply", {"--resolution", "9"})) << piped.out.size();
}

TEST_F(RunStrata, SameSurfaceInAnotherFormatGivesTheSameBytes) {
  WriteFile(In("cube.ply"), CubePly());
  ASSERT_EQ(Strata({"sample", In("cube.ply"), "-o", In("b.drc")}).status, 0);
  EXPECT_TRUE(Written("a.drc", {}) == ReadText(In("b.drc")));
}

TEST_F(RunStrata, UniformSamplesAreAsManyAsAskedAndTheSameBytesFromEveryFormat) {
  WriteFile(In("cube.ply"), CubePly());
  for (const char* format : {"drc", "ply", "xyz", "npz"}) {
    const std::vector<std::string> options = {"--method", "uniform",  "--count",
                                              "5000",     "--format", format};
    const std::string once = Written("a", options);
    std::vector<std::string> other = {"sample", In("cube.ply"), "-o", In("b"), "--threads",
                                      "3",      "--memory",     "64M"};
    other.insert(other.end(), options.begin(), options.end());
    const Outcome outcome = Strata(other);
    ASSERT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("5,000, uniform by area"));
    EXPECT_TRUE(ReadText(In("b")) == once) << format;
  }
}

TEST_F(RunStrata, UniformSamplesWithoutACountAreAsManyAsStratifiedOnes) {
  const std::vector<std::string> uniform = {"--method", "uniform", "--resolution", "20"};
  EXPECT_EQ(Sample("a.ply", {"--resolution", "20", "--summary", In("a.json")}).status, 0);
  const json kept = json::parse(ReadText(In("a.json")))["samples"]["after_rejection"];
  std::vector<std::string> counted = uniform;
  counted.insert(counted.end(), {"--count", kept.dump()});
  EXPECT_TRUE(Written("b.ply", uniform) == Written("c.ply", counted));
}

TEST_F(RunStrata, MoreUniformSamplesThanATileAreAFolder) {
  ASSERT_EQ(
      Sample("out.drc", {"--method", "uniform", "--count", "5000", "--tile-samples", "400"}).status,
      0);
  const json set = json::parse(ReadText(In("out.drc/tileset.json")));
  EXPECT_EQ(set["count"], 5000);
  EXPECT_GT(set["tiles"].size(), 12u);
}

TEST_F(RunStrata, SamplesCarryWhatTheMeshHas) {
  WriteFile(In("cube.obj"),
            "v 0 0 0 1 0 0\nv 4 0 0 0 1 0\nv 4 4 0 0 1 1\nv 0 4 0 1 0 1\nvn 0 3 4\n"
            "g left\nf 1//1 2//1 3//1\ng right\nf 1//1 3//1 4//1\n");
  const std::vector<std::string> options = {"--resolution", "9",         "--attributes",
                                            "normal,group", "--normals", "vertex"};
  const std::string text = Written("a.csv", options);
  EXPECT_THAT(text, StartsWith("x,y,z,nx,ny,nz,group\n"));
  EXPECT_THAT(text, HasSubstr(",0,0.6,0.8,1\n"));
  EXPECT_EQ(Sample("b.ply", {"--attributes", "all", "--summary", In("b.json")}).status, 0);
  const json carried = json::parse(ReadText(In("b.json")))["carried"];
  ASSERT_EQ(carried.size(), 3u);
  EXPECT_EQ(carried[0]["name"], "color");
  EXPECT_EQ(carried[2]["names"], 3);
  EXPECT_THAT(ReadText(In("b.ply")), HasSubstr("comment name group 2 \"right\"\n"));
  const Outcome info = Strata({"info", In("cube.obj"), "--json"});
  const json listed = json::parse(info.out)["attributes"];
  ASSERT_EQ(listed.size(), carried.size());
  for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(listed[k]["name"], carried[k]["name"]);
  const Outcome missing = Sample("c.ply", {"--attributes", "colour"});
  EXPECT_EQ(missing.status, 2);
  EXPECT_THAT(missing.err,
              HasSubstr("'colour' is not there; the mesh carries: color (3 x float32"));
}

TEST_F(RunStrata, SamplesCarryTheColourOfTheTexture) {
  WriteFile(In("cube.obj"),
            "mtllib m.mtl\nv 0 0 0\nv 4 0 0\nv 4 4 0\nvt 0 0\nvt 1 0\nvt 1 1\n"
            "usemtl red\nf 1/1 2/2 3/3\n");
  WriteFile(In("m.mtl"), "newmtl red\nKd 1 0.2 0\nmap_Kd white.png\n");
  const std::vector<std::string> named = {"--attributes", "texture"};
  const Outcome missing = Sample("a.ply", named);
  EXPECT_NE(missing.status, 0);
  EXPECT_THAT(missing.err, HasSubstr("the file 'white.png'"));
  const Outcome all = Sample("a.ply", {"--attributes", "all", "--summary", In("a.json")});
  EXPECT_EQ(all.status, 0) << all.err;
  EXPECT_THAT(all.err, HasSubstr("left out   texture: "));
  const json left_out = json::parse(ReadText(In("a.json")))["left_out"];
  ASSERT_EQ(left_out.size(), 1u);
  EXPECT_THAT(left_out[0].get<std::string>(), HasSubstr("white.png"));

  const std::string white =
      MakePng(MakePixels(2, 2, 3, [](unsigned, unsigned, int) { return 255u; }));
  WriteFile(In("white.png"), white.substr(0, white.size() - 15));
  EXPECT_EQ(Sample("a.ply", named).status, 4);
  const Outcome damaged = Sample("a.ply", {"--attributes", "all"});
  EXPECT_EQ(damaged.status, 0) << damaged.err;
  EXPECT_THAT(damaged.err, HasSubstr("left out   texture: "));
  EXPECT_THAT(damaged.err, HasSubstr("the image 'white.png'"));
  WriteFile(In("white.png"), white);
  EXPECT_THAT(Written("b.csv", named), HasSubstr(",255,51,0\n"));
  const std::string ply = Written("b.ply", named);
  EXPECT_THAT(ply, HasSubstr("property uchar red\nproperty uchar green\nproperty uchar blue\n"));
  EXPECT_THAT(ply, HasSubstr("\"name\":\"texture\",\"type\":\"uint8\",\"components\":3,"
                             "\"semantic\":\"texture\",\"color_space\":\"srgb\""));
  EXPECT_THAT(Written("b.npz", named), HasSubstr("texture.npy"));
  EXPECT_THAT(Written("b.glb", named), HasSubstr("\"COLOR_0\""));
  EXPECT_THAT(Written("b.drc", named), HasSubstr("texture"));
  const Outcome info = Strata({"info", In("cube.obj")});
  EXPECT_THAT(info.out, HasSubstr("texture    white.png: png, 2 x 2, 3 x 8 bits; "
                                  "base colour of 1: red\n"));
  EXPECT_THAT(info.out, HasSubstr("attribute  texture (3 x uint8, triangle)\n"));
}

TEST_F(RunStrata, ThreadsAndBatchesDoNotShowInTheBytes) {
  const std::string once = Written("a.drc", {"--threads", "1"});
  EXPECT_TRUE(Written("b.drc", {"--threads", "3"}) == once);
  EXPECT_TRUE(Written("c.drc", {"--threads", "2", "--batch-size", "1"}) == once);
  EXPECT_FALSE(Written("d.drc", {"--seed", "1"}) == once) << "the seed does nothing";
}

TEST_F(RunStrata, EveryVectorTargetOfThisProcessorWritesTheSameBytes) {
  const std::string once = Written("auto.ply", {});
  // The refusal of a wrong name lists the right ones.
  std::string names = Sample("x.ply", {"--simd", "abacus"}).err;
  names = names.substr(names.find("expected") + 8);
  std::ranges::replace(names, ',', ' ');
  std::istringstream words(names);
  int targets = 0;
  for (std::string name; words >> name; ++targets) {
    EXPECT_TRUE(Written(name + ".ply", {"--simd", name}) == once) << name;
  }
  EXPECT_GE(targets, 2) << names;
}

TEST_F(RunStrata, SummaryCountsWhatWasWritten) {
  const Outcome outcome =
      Sample("a.xyz", {"--resolution", "12", "--summary", In("a.json"), "--attributes", "none"});
  ASSERT_EQ(outcome.status, 0) << outcome.err;
  const json summary = json::parse(ReadText(In("a.json")));
  const std::string text = ReadText(In("a.xyz"));
  std::size_t samples = 0;
  for (std::size_t at = 0; at < text.size(); at = text.find('\n', at) + 1) {
    samples += text[at] != '#';
  }
  EXPECT_EQ(summary["samples"]["after_rejection"], samples);
  EXPECT_GE(summary["cells"], samples);
  EXPECT_EQ(summary["mesh"]["sampled"], 12);
  EXPECT_NEAR(summary["mesh"]["area"].get<double>(), 6, 1e-12);
  EXPECT_EQ(summary["stages"]["write"]["bytes"], text.size());
  EXPECT_GT(summary["peak_memory_bytes"], 0);
}

TEST_F(RunStrata, SummaryGoesToStandardOutputWhenAsked) {
  const Outcome outcome = Sample("a.ply", {"--resolution", "5", "--summary", "-"});
  EXPECT_EQ(json::parse(outcome.out)["program"], "strata");
}

TEST_F(RunStrata, TellsPeopleOnStandardErrorUnlessQuiet) {
  const Outcome loud = Sample("a.ply", {"--resolution", "5"});
  EXPECT_THAT(loud.err, AllOf(HasSubstr("samples"), HasSubstr("triangles"), HasSubstr("area")));
  EXPECT_EQ(loud.err.find('\x1b'), std::string::npos) << "a progress bar went into a pipe";
  EXPECT_EQ(loud.err.find('\r'), std::string::npos);
  EXPECT_EQ(loud.out, "");
  const Outcome quiet = Sample("a.ply", {"--resolution", "5", "--quiet"});
  EXPECT_EQ(quiet.err + quiet.out, "");
}

TEST_F(RunStrata, DrawsAPicture) {
  ASSERT_EQ(Sample("a.ply", {"--picture", In("a.png")}).status, 0);
  EXPECT_THAT(ReadText(In("a.png")).substr(0, 8), StartsWith("\x89PNG\r\n"));
}

TEST_F(RunStrata, InfoCountsAndMeasures) {
  const Outcome text = Strata({"info", In("cube.obj")});
  EXPECT_EQ(text.status, 0) << text.err;
  EXPECT_THAT(text.out, AllOf(HasSubstr("obj"), HasSubstr("12"), HasSubstr("0 0 0  to  1 1 1")));
  const json found = json::parse(Strata({"info", "-", "--json"}, OneGoodOneFlatObj()).out);
  EXPECT_EQ(found["triangles"], 2);
  EXPECT_EQ(found["surface_triangles"], 1);
  EXPECT_EQ(found["skipped"]["zero_area"], 1);
}

// --- What goes wrong, and that nothing is left then ----------------------------------------------

/// Samples `mesh` and expects `status`, a message that holds `words`, and no file.
void ExpectRefused(const std::string& mesh, int status, const std::string& words,
                   const std::vector<std::string>& options = {}) {
  const ScratchFolder folder;
  std::vector<std::string> arguments = {"sample", "-", "-o", folder / "out.drc"};
  arguments.insert(arguments.end(), options.begin(), options.end());
  const Outcome outcome = Strata(arguments, mesh);
  EXPECT_EQ(outcome.status, status) << outcome.err;
  EXPECT_THAT(outcome.err, AllOf(StartsWith("strata: "), HasSubstr(words)));
  EXPECT_THAT(folder.Names(), IsEmpty());
}

TEST(StrataRefuses, WhatHasNoArea) { ExpectRefused(FlatObj(), 6, ""); }
TEST(StrataRefuses, ATruncatedFile) {
  ExpectRefused(CubePly().substr(0, CubePly().size() - 20), 4, "");
}
TEST(StrataRefuses, AnUnknownFormat) { ExpectRefused("%PDF-1.4\n%\xe2\xe3\n1 0 obj\n", 5, ""); }
TEST(StrataRefuses, ASkippedTriangleWhenStrict) {
  ExpectRefused(OneGoodOneFlatObj(), 4, "", {"--strict"});
}
TEST(StrataRefuses, ALatticeThatIsTooFine) {
  ExpectRefused(CubeObj(), 7, "", {"--voxel-size", "1e-30"});
}

TEST_F(RunStrata, KeepsWithinTheMemoryItIsGiven) {
  if (STRATA_SANITIZED) GTEST_SKIP() << "a sanitizer maps more than any limit that says something";
  // Three million cells, which take a gigabyte when all are in memory.
  const std::vector<std::string> fine = {"--resolution", "700", "--threads", "2"};
  const std::string whole = Written("whole.ply", fine);
  const Outcome outcome =
      Strata({"sample", In("cube.obj"), "-o", In("out.ply"), "--resolution", "700", "--threads",
              "2", "--memory", "64M", "--scratch", folder.path()},
             "", {.address_space_bytes = std::uint64_t{600} << 20});
  EXPECT_EQ(outcome.status, 0) << outcome.err;
  EXPECT_TRUE(ReadText(In("out.ply")) == whole);
  EXPECT_THAT(folder.Names(), ElementsAre("cube.obj", "out.ply", "whole.ply"));
}

TEST_F(RunStrata, RefusesAMissingScratchDirectory) {
  const Outcome outcome = Sample("out.ply", {"--scratch", In("absent")});
  EXPECT_EQ(outcome.status, 3) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr(In("absent")));
  EXPECT_THAT(folder.Names(), ElementsAre("cube.obj"));
}

TEST_F(RunStrata, NamesTheInputWhoseSurfaceItRefuses) {
  WriteFile(In("flat.obj"), FlatObj());
  WriteFile(In("part.obj"), OneGoodOneFlatObj());
  const auto refusal = [&](const std::string& input, const std::vector<std::string>& options) {
    std::vector<std::string> arguments = {"sample", In(input), "-o", In("out.ply")};
    arguments.insert(arguments.end(), options.begin(), options.end());
    return Strata(arguments).err;
  };
  EXPECT_THAT(refusal("flat.obj", {}), StartsWith("strata: " + In("flat.obj") + ": no triangle"));
  EXPECT_THAT(refusal("part.obj", {"--strict"}),
              StartsWith("strata: " + In("part.obj") + ": triangle 1 "));
  EXPECT_THAT(refusal("cube.obj", {"--voxel-size", "1e-30"}),
              StartsWith("strata: " + In("cube.obj") + ": triangle "));
  EXPECT_THAT(Strata({"sample", "-", "-o", In("out.ply")}, FlatObj()).err,
              StartsWith("strata: standard input: no triangle"));
}

TEST_F(RunStrata, SaysWhichInputIsMissing) {
  const Outcome outcome = Strata({"sample", In("absent.ply"), "-o", In("out.drc")});
  EXPECT_EQ(outcome.status, 3);
  EXPECT_THAT(outcome.err, HasSubstr("absent.ply"));
  EXPECT_THAT(folder.Names(), ElementsAre("cube.obj"));
  EXPECT_EQ(Strata({"info", In("absent.ply")}).status, 3);
}

TEST_F(RunStrata, RefusesAFolderAsInput) {
  const Outcome outcome = Strata({"info", folder.path().string()});
  EXPECT_EQ(outcome.status, 3) << outcome.err;
}

TEST_F(RunStrata, RefusesAnInputItMayNotOpen) {
  ASSERT_EQ(chmod(In("cube.obj").c_str(), 0), 0);
  const Outcome outcome = Strata({"info", In("cube.obj")}, "", {.without_rights = true});
  EXPECT_EQ(outcome.status, 3) << outcome.err;
  EXPECT_THAT(outcome.err, HasSubstr("cube.obj"));
}

TEST_F(RunStrata, FindsAnUnwritableFolderBeforeItReads) {
  // Standard input never ends here: only a check that comes first can end the command.
  Child strata(STRATA_BINARY, {"sample", "-", "-o", In("absent/out.ply")});
  EXPECT_EQ(strata.Wait(), 8);
  EXPECT_THAT(strata.Err(), HasSubstr("absent/out.ply"));
  ASSERT_EQ(chmod(folder.path().c_str(), 0555), 0);
  Child other(STRATA_BINARY, {"sample", "-", "-o", In("out.ply")}, {.without_rights = true});
  EXPECT_EQ(other.Wait(), 8);
  EXPECT_THAT(other.Err(), HasSubstr("out.ply"));
}

TEST_F(RunStrata, FindsAFullDisk) {
  for (const char* format : {"drc", "ply", "xyz", "npz"}) {
    const Outcome outcome =
        Strata({"sample", In("cube.obj"), "-o", "/dev/full", "--format", format});
    EXPECT_EQ(outcome.status, 8) << format << ": " << outcome.err;
  }
}

TEST_F(RunStrata, TakesAClosedStandardStreamForAnError) {
  Child no_input(STRATA_BINARY, {"info", "-"}, {.closed = {0}});
  EXPECT_EQ(no_input.Wait(), 8) << no_input.Err();
  Child no_output(STRATA_BINARY, {"info", In("cube.obj")}, {.closed = {1}});
  EXPECT_EQ(no_output.Wait(), 8) << no_output.Err();
  EXPECT_THAT(no_output.Err(), HasSubstr("Bad file descriptor"));
}

TEST_F(RunStrata, KeepsWhatIsMeantForAClosedStreamOutOfItsFiles) {
  const std::string whole = Written("a.ply", {"--resolution", "9"});
  Child strata(STRATA_BINARY, {"sample", In("cube.obj"), "-o", In("b.ply"), "--resolution", "9"},
               {.closed = {0, 1, 2}});
  EXPECT_EQ(strata.Wait(), 0);
  EXPECT_TRUE(ReadText(In("b.ply")) == whole);
}

TEST_F(RunStrata, RefusesTwoOutputsOfOneNameHoweverItIsWritten) {
  std::filesystem::create_directory(In("sub"));
  for (const char* same : {"out.ply", "./out.ply", "sub/../out.ply"}) {
    const Outcome outcome = Sample("out.ply", {"--summary", In(same)});
    EXPECT_EQ(outcome.status, 2) << same << ": " << outcome.err;
    EXPECT_THAT(folder.Names(), ElementsAre("cube.obj", "sub")) << same;
  }
}

TEST_F(RunStrata, RefusesToOverwriteItsInput) {
  const std::string before = ReadText(In("cube.obj"));
  ASSERT_EQ(symlink(In("cube.obj").c_str(), In("link.obj").c_str()), 0);
  ASSERT_EQ(link(In("cube.obj").c_str(), In("hard.obj").c_str()), 0);
  for (const char* name : {"cube.obj", "link.obj", "hard.obj"}) {
    const Outcome outcome = Sample(name, {"--format", "ply"});
    EXPECT_EQ(outcome.status, 2) << name;
    EXPECT_THAT(outcome.err, HasSubstr("INPUT and OUTPUT are the same file"));
  }
  EXPECT_EQ(Sample("a.ply", {"--summary", In("a.ply")}).status, 2);
  EXPECT_EQ(Sample("a.ply", {"--picture", In("cube.obj")}).status, 2);
  EXPECT_EQ(ReadText(In("cube.obj")), before);
}

TEST_F(RunStrata, ReplacesAnOldOutputOnlyWhenItSucceeds) {
  WriteFile(In("out.ply"), "old");
  const std::vector<std::string> impossible = {"--voxel-size", "1e-30"};
  EXPECT_EQ(Sample("out.ply", impossible).status, 7);
  EXPECT_EQ(ReadText(In("out.ply")), "old");
  EXPECT_THAT(Written("out.ply", {"--resolution", "5"}).substr(0, 4), StartsWith("ply\n"));
}

TEST_F(RunStrata, RefusesAnUnknownVectorTarget) {
  const Outcome outcome = Sample("a.ply", {"--simd", "abacus"});
  EXPECT_EQ(outcome.status, 2);
  EXPECT_THAT(outcome.err, HasSubstr("abacus"));
}

}  // namespace
}  // namespace strata::test
