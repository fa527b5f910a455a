#include "server/batch/model_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>

#include "server/batch/batch_config.h"
#include "server/batch/batch_lane.h"
#include "server/batch/folder_places.h"
#include "tests/support/temp_folder.h"

namespace strata::server {
namespace {

using test::TempFolder;
using test::WriteFile;
using testing::HasSubstr;

class ModelOptionsTest : public testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(folder / "a/b");
    auto opened = OpenFolderSource(folder.path(), folder / "out");
    ASSERT_TRUE(opened) << opened.error().message;
    source = *std::move(opened);
  }
  nlohmann::json Of(const std::string& path, OptionTexts command_line = {}) {
    ModelOptionsFinder finder(*source, std::move(command_line));
    const auto options = finder.Of(path);
    if (!options) ADD_FAILURE() << options.error().message;
    return options ? nlohmann::json::parse((*options)->json) : nlohmann::json();
  }
  std::string ErrorOf(const std::string& text) {
    WriteFile(folder / "a/strata.toml", text);
    ModelOptionsFinder finder(*source, {});
    const auto options = finder.Of("a/x.ply");
    return options ? "none" : options.error().message;
  }

  TempFolder folder;
  std::unique_ptr<ModelSource> source;
};

TEST_F(ModelOptionsTest, TheNearestFileWinsForEachOption) {
  WriteFile(folder / "strata.toml", "resolution = 32\nlambda = 2.5\nformat = \"ply\"\n");
  WriteFile(folder / "a/b/strata.toml", "resolution = 64\nstrict = true\n");
  const auto deep = Of("a/b/x.ply");
  EXPECT_EQ(deep["resolution"], 64);
  EXPECT_EQ(deep["lambda"], 2.5);
  EXPECT_EQ(deep["strict"], true);
  EXPECT_EQ(deep["format"], "ply");
  EXPECT_EQ(Of("a/x.ply")["resolution"], 32);
  EXPECT_EQ(Of("x.ply")["strict"], false);
}

TEST_F(ModelOptionsTest, TheCommandLineGoesBeforeAllFiles) {
  WriteFile(folder / "strata.toml", "resolution = 32\nlambda = 2\n");
  const auto options = Of("x.ply", {{"resolution", "8"}});
  EXPECT_EQ(options["resolution"], 8);
  EXPECT_EQ(options["lambda"], 2);
}

TEST_F(ModelOptionsTest, TheThreeWaysToSayWhereAreOneOption) {
  WriteFile(folder / "strata.toml", "resolution = 32\n");
  WriteFile(folder / "a/strata.toml", "voxel-size = 0.5\n");
  const auto options = Of("a/x.ply");
  EXPECT_EQ(options["voxel_size"], 0.5);
  EXPECT_FALSE(options.contains("resolution"));
  EXPECT_EQ(Of("a/x.ply", {{"height", "5"}})["height"], 5);
}

TEST_F(ModelOptionsTest, AFilesMistakeIsNamedWithItsLine) {
  const std::string name = folder / "a/strata.toml";
  EXPECT_THAT(ErrorOf("\nresolutoin = 3\n"),
              testing::AllOf(HasSubstr(name + ", line 2"), HasSubstr("'resolution'")));
  EXPECT_THAT(ErrorOf("lambda = -1\n"),
              testing::AllOf(HasSubstr(name + ", line 1"), HasSubstr("0 to 500")));
  EXPECT_THAT(ErrorOf("a = \n"), HasSubstr(name + ", line 1"));
  EXPECT_THAT(ErrorOf("resolution = 3\nheight = 4\n"), HasSubstr("exclude each other"));
  EXPECT_THAT(ErrorOf("strict = 1\n"), HasSubstr("true or false"));
  EXPECT_THAT(ErrorOf("lambda = true\n"), HasSubstr("a text or a number"));
  for (const char* const of_run : {"memory", "threads", "output", "picture", "quiet", "resume"}) {
    EXPECT_THAT(ErrorOf(std::string(of_run) + " = 1\n"), HasSubstr("unknown option")) << of_run;
  }
}

Result<BatchCommand> Parsed(const std::vector<std::string>& arguments) {
  const auto parsed = ParseBatch(arguments);
  if (!parsed) return Forward(parsed);
  return std::get<BatchCommand>(*parsed);
}

TEST(BatchConfig, TakesSampleOptionsAndItsOwn) {
  const auto command = Parsed({"repo", "-o", "out", "--resolution", "16", "--jobs", "3", "--share",
                               "2/5", "--include", "a*", "--include", "b*", "--strict"});
  ASSERT_TRUE(command) << command.error().message;
  EXPECT_EQ(command->repository, "repo");
  EXPECT_EQ(command->jobs, 3u);
  EXPECT_EQ(command->share.index, 2u);
  EXPECT_EQ(command->share.count, 5u);
  EXPECT_EQ(ShareSuffix(command->share), "-2-of-5");
  EXPECT_EQ(command->filter.include, (std::vector<std::string>{"a*", "b*"}));
  EXPECT_EQ(command->options, (OptionTexts{{"resolution", "16"}, {"strict", "true"}}));
}

TEST(BatchConfig, NamesWhatIsWrong) {
  const auto message = [](const std::vector<std::string>& arguments) {
    const auto command = Parsed(arguments);
    return command ? "none" : command.error().message;
  };
  EXPECT_THAT(message({"-o", "out"}), HasSubstr("REPO is missing"));
  EXPECT_THAT(message({"repo"}), HasSubstr("-o OUT is missing"));
  EXPECT_THAT(message({"a", "b", "-o", "out"}), HasSubstr("second REPO 'b'"));
  EXPECT_THAT(message({"a", "-o", "out", "--share", "5/5"}), HasSubstr("--share"));
  EXPECT_THAT(message({"a", "-o", "out", "--memory", "64M"}), HasSubstr("192M"));
  EXPECT_THAT(message({"a", "-o", "out", "--lambda", "x"}), HasSubstr("--lambda: found 'x'"));
  EXPECT_THAT(message({"a", "-o", "out", "--resolutoin", "3"}), HasSubstr("--resolution"));
  EXPECT_THAT(message({"a", "-o", "out", "--force", "--resume"}), HasSubstr("exclude"));
}

TEST(DivideMemory, GivesEveryJobItsPartAndNeverMoreThanAll) {
  for (const std::uint64_t memory :
       {kLeastBatchMemory, std::uint64_t{1} << 30, std::uint64_t{1} << 34}) {
    for (const std::uint32_t jobs : {1u, 2u, 64u}) {
      const MemoryParts parts = DivideMemory(memory, jobs, 1000);
      EXPECT_GE(parts.lanes, 1u);
      EXPECT_LE(parts.lanes, jobs);
      EXPECT_GE(parts.small_bytes, kLeastMemory) << memory << " for " << jobs;
      EXPECT_GE(parts.whole_bytes, parts.small_bytes);
      EXPECT_LT(parts.lanes * parts.small_bytes, memory);
      EXPECT_LT(parts.whole_bytes, memory);
    }
  }
  EXPECT_EQ(DivideMemory(std::uint64_t{1} << 34, 8, 2).lanes, 2u) << "no more than models";
}

}  // namespace
}  // namespace strata::server
