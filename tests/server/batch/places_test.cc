#include "server/batch/places.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "server/batch/batch_plan.h"
#include "server/batch/folder_places.h"
#include "tests/support/temp_folder.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;
using test::TempFolder;
using test::WriteFile;
using testing::ElementsAre;

class PlacesTest : public testing::Test {
 protected:
  void Put(const std::string& path) {
    fs::create_directories((fs::path(folder.path()) / path).parent_path());
    WriteFile(folder / path, "x");
  }
  std::vector<std::string> List(const ModelFilter& filter = {}) {
    const auto source = OpenFolderSource(folder / "repo", folder / "repo/out");
    if (!source) ADD_FAILURE() << source.error().message;
    const auto models = (*source)->List(filter);
    if (!models) ADD_FAILURE() << models.error().message;
    std::vector<std::string> paths;
    for (const ModelEntry& model : *models) paths.push_back(model.path);
    std::ranges::sort(paths);
    return paths;
  }
  TempFolder folder;
};

TEST_F(PlacesTest, MeshesAreListedAndHiddenOnesAndOutputsAreNot) {
  for (const char* const path :
       {"repo/a.ply", "repo/b/c.OBJ.gz", "repo/b/notes.txt", "repo/.git/d.ply", "repo/.e.ply",
        "repo/out/a.ply.ply", "repo/b/-f.stl", "repo/b/g\nh.off"}) {
    Put(path);
  }
  EXPECT_THAT(List(), ElementsAre("a.ply", "b/-f.stl", "b/c.OBJ.gz", "b/g\nh.off"));
  EXPECT_THAT(List({{}, {}, true}),
              ElementsAre("a.ply", "b/-f.stl", "b/c.OBJ.gz", "b/g\nh.off", "b/notes.txt"));
  EXPECT_THAT(List({{"b/**"}, {"*.stl"}, false}), ElementsAre("b/c.OBJ.gz", "b/g\nh.off"));
}

TEST_F(PlacesTest, LinksAreFollowedToFilesInsideAndNowhereElse) {
  Put("repo/a/x.ply");
  Put("outside/y.ply");
  fs::create_symlink("a/x.ply", folder / "repo/inside.ply");
  fs::create_symlink("../outside/y.ply", folder / "repo/outside.ply");
  fs::create_directory_symlink(".", folder / "repo/a/loop");
  fs::create_symlink("nothing.ply", folder / "repo/dangling.ply");
  fs::create_symlink("self.ply", folder / "repo/self.ply");
  // Those that cannot be followed are listed, to fail with their reason.
  EXPECT_THAT(List(),
              ElementsAre("a/x.ply", "dangling.ply", "inside.ply", "outside.ply", "self.ply"));
  for (const char* const path : {"dangling.ply", "outside.ply", "self.ply"}) {
    const auto source = OpenFolderSource(folder / "repo", folder / "out");
    const auto models = (*source)->List({});
    ASSERT_TRUE(models) << models.error().message;
    const auto model = std::ranges::find(*models, path, &ModelEntry::path);
    ASSERT_NE(model, models->end()) << path;
    const auto fetched = (*source)->Fetch(*model, {});
    ASSERT_FALSE(fetched) << path;
    EXPECT_EQ(fetched.error().code, ErrorCode::kUnsupported) << fetched.error().message;
  }
  const auto source = OpenFolderSource(folder / "repo", folder / "out");
  for (const char* const path : {"../outside/y.ply", "/etc/passwd", "outside.ply", "a/../a/x.ply",
                                 "a//x.ply", "", "a", "./a/x.ply"}) {
    const auto found = (*source)->Find(path);
    ASSERT_TRUE(found) << path;
    EXPECT_FALSE(found->has_value()) << path;
  }
}

TEST_F(PlacesTest, FoldersThatAreExcludedAreNotLookedInto) {
  for (const char* const path : {"repo/a/x.ply", "repo/b/a/y.ply", "repo/b/z.ply"}) Put(path);
  // A link that leads nowhere would be listed.
  fs::create_symlink("nothing.ply", folder / "repo/b/a/dangling.ply");
  EXPECT_THAT(List({{}, {"a/"}, false}), ElementsAre("b/z.ply"));
  EXPECT_THAT(List({{}, {"/a/"}, false}), ElementsAre("b/a/dangling.ply", "b/a/y.ply", "b/z.ply"));
  EXPECT_THAT(List({{}, {"b/**"}, false}), ElementsAre("a/x.ply"));
  EXPECT_THAT(List({{"a/"}, {"b/a/"}, false}), ElementsAre("a/x.ply"));
  EXPECT_TRUE(PassesOver({{}, {"old/"}, false}, "x/old"));
  EXPECT_TRUE(PassesOver({{}, {"x/**"}, false}, "x"));
  EXPECT_FALSE(PassesOver({{}, {"x/**"}, false}, "y/x")) << "a glob with a / begins at the root";
  EXPECT_FALSE(PassesOver({{}, {"*", "**", "x", "x/*"}, false}, "x"));
}

TEST(ModelPaths, StayBelowTheirPlace) {
  for (const char* const path : {"a", "a/b.ply", "..a/b..", "-", "a b/\xff"}) {
    EXPECT_TRUE(IsModelPath(path)) << path;
  }
  for (const char* const path :
       {"", "/", "/a", "a/", "a//b", ".", "..", "../a", "a/../b", "a/./b"}) {
    EXPECT_FALSE(IsModelPath(path)) << path;
  }
  EXPECT_FALSE(IsModelPath(std::string_view("a\0b", 3)));
}

TEST_F(PlacesTest, OutputsMayNotMixWithModels) {
  Put("repo/a.ply");
  for (const std::string& out : {folder / "repo", folder.path(), folder / "repo/."}) {
    const auto source = OpenFolderSource(folder / "repo", out);
    ASSERT_FALSE(source) << out;
    EXPECT_EQ(source.error().code, ErrorCode::kInvalidArgument);
  }
  EXPECT_EQ(OpenFolderSource(folder / "none", folder / "o").error().code, ErrorCode::kNotFound);
  EXPECT_TRUE(OpenFolderSource(folder / "repo", folder / "repo2"));
}

TEST_F(PlacesTest, AnOutputIsRemovedWithTheFoldersThatAreEmptyThen) {
  const auto outputs = OpenFolderOutput(folder / "out");
  ASSERT_TRUE(outputs->OpenState());
  const auto path = outputs->LocalPath("a/b/c.ply.drc");
  ASSERT_TRUE(path) << path.error().message;
  WriteFile(*path, "12345");
  WriteFile(folder / "out/a/kept", "");
  EXPECT_TRUE(*outputs->IsThere("a/b/c.ply.drc", 5));
  EXPECT_FALSE(*outputs->IsThere("a/b/c.ply.drc", 4));
  ASSERT_TRUE(outputs->Remove("a/b/c.ply.drc"));
  EXPECT_FALSE(fs::exists(folder / "out/a/b"));
  EXPECT_TRUE(fs::exists(folder / "out/a/kept"));
  EXPECT_TRUE(outputs->Remove("a/b/c.ply.drc")) << "what is not there is no error";
  fs::create_directories(folder / "out/t.drc/tiles");
  WriteFile(folder / "out/t.drc/tileset.json", "{}");
  WriteFile(folder / "out/t.drc/tiles/0.drc", "1234");
  EXPECT_TRUE(*outputs->IsThere("t.drc", 6));
  ASSERT_TRUE(outputs->Remove("t.drc"));
  EXPECT_FALSE(fs::exists(folder / "out/t.drc"));
}

TEST(Shares, EveryPathIsInExactlyOne) {
  std::vector<int> sizes(7, 0);
  for (int i = 0; i < 7000; ++i) {
    const std::string path = "models/" + std::to_string(i) + ".ply";
    int in = 0;
    for (std::uint32_t share = 0; share < 7; ++share) {
      if (!InShare(path, {share, 7})) continue;
      ++in;
      ++sizes[share];
    }
    ASSERT_EQ(in, 1) << path;
    ASSERT_TRUE(InShare(path, {0, 1}));
  }
  for (const int size : sizes) EXPECT_NEAR(size, 1000, 120) << "4 sigma of 7000 over 7";
}

}  // namespace
}  // namespace strata::server
