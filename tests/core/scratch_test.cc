#include "core/scratch.h"

#include <gtest/gtest.h>

#include <string>

#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

TEST(Scratch, GivesBackWhatWasWritten) {
  TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch) << scratch.error().message;
  const auto file = (*scratch)->NewFile();
  ASSERT_TRUE(file) << file.error().message;
  ASSERT_TRUE((*file)->Append("hello "));
  ASSERT_TRUE((*file)->Append("world"));
  ASSERT_TRUE((*file)->WriteAt(20, "!"));
  EXPECT_EQ((*file)->size(), 21u);
  std::string read(5, ' ');
  ASSERT_TRUE((*file)->ReadAt(6, read));
  EXPECT_EQ(read, "world");
  const auto beyond = (*file)->ReadAt(19, read);
  ASSERT_FALSE(beyond);
  EXPECT_EQ(beyond.error().code, ErrorCode::kIo);
}

TEST(Scratch, FilesHaveNoName) {
  TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch);
  const auto file = (*scratch)->NewFile();
  ASSERT_TRUE((*file)->Append("x"));
  EXPECT_TRUE(folder.List().empty());
}

TEST(Scratch, SaysWhichDirectoryIsMissing) {
  const auto missing = ScratchFolder::Open("/nonexistent/scratch");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  EXPECT_NE(missing.error().message.find("/nonexistent/scratch"), std::string::npos);
}

}  // namespace
}  // namespace strata::test
