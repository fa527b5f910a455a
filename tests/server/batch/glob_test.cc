#include "server/batch/glob.h"

#include <gtest/gtest.h>

#include <string>

namespace strata::server {
namespace {

TEST(Glob, AStarStopsAtASlashAndTwoDoNot) {
  EXPECT_TRUE(MatchesGlob("a/*.ply", "a/b.ply"));
  EXPECT_FALSE(MatchesGlob("a/*.ply", "a/b/c.ply"));
  EXPECT_TRUE(MatchesGlob("a/**.ply", "a/b/c.ply"));
  EXPECT_TRUE(MatchesGlob("a/**/c.ply", "a/b/d/c.ply"));
  EXPECT_TRUE(MatchesGlob("a/**/c.ply", "a/c.ply")) << "**/ may be nothing";
  EXPECT_FALSE(MatchesGlob("a/**/c.ply", "a/bc.ply")) << "but not a part of a name";
  EXPECT_TRUE(MatchesGlob("cars/**", "cars/x/y.stl"));
  EXPECT_FALSE(MatchesGlob("cars/**", "cars.stl"));
}

TEST(Glob, WithoutASlashMatchesTheNameAlone) {
  EXPECT_TRUE(MatchesGlob("*.stl", "a/b/c.stl"));
  EXPECT_FALSE(MatchesGlob("a*", "a/b.stl"));
  EXPECT_TRUE(MatchesGlob("**/b.stl", "b.stl"));
}

TEST(Glob, ASlashBeforeAndBehindBindsToTheRootAndToFolders) {
  EXPECT_TRUE(MatchesGlob("/a.ply", "a.ply"));
  EXPECT_FALSE(MatchesGlob("/a.ply", "b/a.ply"));
  EXPECT_TRUE(MatchesGlob("./b/*.ply", "b/a.ply"));
  EXPECT_TRUE(MatchesGlob("old/", "old/a.ply"));
  EXPECT_TRUE(MatchesGlob("old/", "x/old/y/a.ply"));
  EXPECT_FALSE(MatchesGlob("old/", "x/old")) << "a file of this name is no folder";
  EXPECT_FALSE(MatchesGlob("/old/", "x/old/a.ply"));
  EXPECT_TRUE(MatchesGlob("x/o*/", "x/old/a.ply"));
  EXPECT_FALSE(MatchesGlob("x/o*/", "y/x/old/a.ply"));
  EXPECT_FALSE(MatchesGlob("/", "a.ply"));
  EXPECT_FALSE(MatchesGlob("", "a.ply"));
}

TEST(Glob, SetsAndEscapesAreOneByte) {
  EXPECT_TRUE(MatchesGlob("[a-c]?.ply", "b1.ply"));
  EXPECT_FALSE(MatchesGlob("[!a-c]?.ply", "b1.ply"));
  EXPECT_TRUE(MatchesGlob("[]]x", "]x"));
  EXPECT_TRUE(MatchesGlob("\\*.ply", "*.ply"));
  EXPECT_FALSE(MatchesGlob("\\*.ply", "a.ply"));
  EXPECT_TRUE(MatchesGlob("[x", "[x")) << "a bracket that is never closed is itself";
  EXPECT_TRUE(MatchesGlob("a\n\xff*",
                          "a\n\xff"
                          "b"));
}

TEST(Glob, ManyStarsEndSoon) {
  std::string glob, path(2000, 'a');
  for (int i = 0; i < 200; ++i) glob += "*a";
  EXPECT_FALSE(MatchesGlob(glob + "b", path));
  EXPECT_TRUE(MatchesGlob(glob, path));
}

}  // namespace
}  // namespace strata::server
