#include "server/store/data_folder.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/store/schema.h"
#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

TEST(DataFolder, BelongsToOneProcessUntilThatOneDies) {
  test::TempFolder folder;
  int ready[2];
  ASSERT_EQ(pipe(ready), 0);
  const pid_t child = fork();
  if (child == 0) {
    auto owned = DataFolder::Open(folder / "data");
    if (!owned || write(ready[1], "x", 1) != 1) _exit(1);
    for (;;) pause();
  }
  close(ready[1]);
  char byte = 0;
  ASSERT_EQ(read(ready[0], &byte, 1), 1);
  close(ready[0]);
  const auto refused = DataFolder::Open(folder / "data");
  EXPECT_FALSE(refused);
  if (!refused) {
    EXPECT_EQ(refused.error().code, ErrorCode::kConflict);
    EXPECT_NE(refused.error().message.find(std::to_string(child)), std::string::npos)
        << Why(refused);
  }
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  EXPECT_OK(DataFolder::Open(folder / "data"));
}

TEST(DataFolder, CannotBeMadeInsideOfNothing) {
  test::TempFolder folder;
  EXPECT_FAILS(ErrorCode::kNotFound, DataFolder::Open(folder / "no/such/data"));
  test::WriteFile(folder / "file", "x");
  EXPECT_FAILS(ErrorCode::kIo, DataFolder::Open(folder / "file"));
}

TEST(Database, MayBeReachedThroughALinkedFolderButIsNoLinkItself) {
  test::TempFolder folder;
  std::filesystem::create_directory(folder / "real");
  std::filesystem::create_directory_symlink("real", folder / "linked");
  EXPECT_OK(Database::Open(folder / "linked/a.db"));
  EXPECT_TRUE(std::filesystem::exists(folder / "real/a.db"));
  std::filesystem::create_symlink("a.db", folder / "real/b.db");
  EXPECT_FAILS(ErrorCode::kIo, Database::Open(folder / "linked/b.db"));
}

TEST(Schema, IsRefusedWhenANewerProgramWroteIt) {
  test::TempFolder folder;
  for (const int version : {SchemaVersion() + 1, -1}) {
    const std::string path = folder / "v" + std::to_string(version);
    auto database = Database::Open(path);
    ASSERT_OK(database);
    ASSERT_OK(Migrate(**database));
    ASSERT_OK((*database)->Read().RunScript("PRAGMA user_version = " + std::to_string(version)));
    EXPECT_FAILS(ErrorCode::kUnsupported, Migrate(**database));
  }
}

TEST(Schema, IsRefusedInAnotherProgramsDatabase) {
  test::TempFolder folder;
  auto database = Database::Open(folder / "db");
  ASSERT_OK(database);
  ASSERT_OK((*database)->Read().RunScript("CREATE TABLE theirs (x)"));
  EXPECT_FAILS(ErrorCode::kCorruptInput, Migrate(**database));
}

TEST(Schema, MigratingTwiceChangesNothing) {
  test::TempFolder folder;
  auto database = Database::Open(folder / "db");
  ASSERT_OK(database);
  ASSERT_OK(Migrate(**database));
  ASSERT_OK(Migrate(**database));
  std::int64_t version = 0, foreign_keys = 0;
  ASSERT_OK((*database)->Read().Query("PRAGMA user_version",
                                      [&](const Row& row) { version = row.Int(0); }));
  ASSERT_OK((*database)->Read().Query("PRAGMA foreign_keys",
                                      [&](const Row& row) { foreign_keys = row.Int(0); }));
  EXPECT_EQ(version, SchemaVersion());
  EXPECT_EQ(foreign_keys, 1);
}

TEST(Database, ABlobInUseCannotBeForgotten) {
  test::TempFolder folder;
  auto database = Database::Open(folder / "db");
  ASSERT_OK(database);
  ASSERT_OK(Migrate(**database));
  ASSERT_OK(
      (*database)->Read().RunScript("INSERT INTO blobs (hash, size, kind) VALUES ('h', 1, 0); "
                                    "INSERT INTO models VALUES ('m', 'h', '', 0, 0)"));
  EXPECT_FAILS(ErrorCode::kInternal, (*database)->Read().Run("DELETE FROM blobs"));
}

TEST(Database, WhatIsNotCommittedIsTakenBack) {
  test::TempFolder folder;
  auto database = Database::Open(folder / "db");
  ASSERT_OK(database);
  ASSERT_OK((*database)->Read().RunScript("CREATE TABLE t (x)"));
  {
    auto session = (*database)->Write();
    ASSERT_OK(session);
    ASSERT_OK(session->Run("INSERT INTO t VALUES (?)", "text"));
  }
  int rows = 0;
  ASSERT_OK((*database)->Read().Query("SELECT x FROM t", [&](const Row&) { ++rows; }));
  EXPECT_EQ(rows, 0);
}

TEST(Database, GarbageIsACorruptInputThatNamesTheFile) {
  test::TempFolder folder;
  test::WriteFile(folder / "db", Bytes(8192, 3));
  const auto opened = Database::Open(folder / "db");
  EXPECT_FAILS(ErrorCode::kCorruptInput, opened);
  EXPECT_TRUE(opened.error().message.starts_with(folder / "db")) << Why(opened);
}

}  // namespace
}  // namespace strata::server
