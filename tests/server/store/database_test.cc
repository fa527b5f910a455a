// What tells a database that is away from one that has something else to say.
#include "server/store/database.h"

#include <gtest/gtest.h>

#include "server/store/object_place.h"
#include "server/store/postgres.h"
#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

TEST(Database, ThatCannotBeReachedIsAway) {
  // Nothing listens there.
  const auto opened = OpenPostgres({.url = "postgresql://nobody@127.0.0.1:1/none", .password = ""});
  EXPECT_FAILS(ErrorCode::kIo, opened);
  EXPECT_TRUE(IsDatabaseAway(opened.error())) << Why(opened);
  EXPECT_FALSE(IsBucketAway(opened.error()));
  EXPECT_TRUE(IsStoreAway(opened.error()));
}

TEST(Database, IsNotAwayBecauseAMessageSaysSo) {
  for (const char* const folder : {"the database is away: ", "the bucket is away: "}) {
    const auto opened = Database::Open(std::string(folder) + "none/strata.db");
    EXPECT_FAILS(ErrorCode::kIo, opened);
    EXPECT_TRUE(opened.error().message.starts_with(folder)) << Why(opened);
    EXPECT_FALSE(IsStoreAway(opened.error())) << Why(opened);
  }
}

TEST(Database, ThatIsAwayStaysSoWhateverIsSaidInFront) {
  const Error away = FailDatabaseAway("no route").value();
  const auto wrapped = Fail(away.code, "upload 7: " + away.message, away.kind);
  EXPECT_TRUE(IsDatabaseAway(wrapped.value()));
  EXPECT_FALSE(IsBucketAway(wrapped.value()));
}

}  // namespace
}  // namespace strata::server
