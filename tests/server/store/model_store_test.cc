#include "server/store/model_store.h"

#include <gtest/gtest.h>

#include <set>
#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

using Names = std::vector<std::string>;
using Kind = ModelCondition::Kind;

class ModelStoreTest : public StoreTest {
 protected:
  void UseRepository() {
    options.models = folder / "models";
    std::filesystem::create_directories(options.models + "/cars");
    test::WriteFile(options.models + "/cars/b.off", kOff);
    Open();
  }
  Names ListAll(ModelQuery query) {
    Names names;
    for (int pages = 0; pages < 1000; ++pages) {
      const auto page = store->models().List(query);
      EXPECT_OK(page);
      if (!page) break;
      EXPECT_LE(page->models.size(), query.size);
      for (const ModelInfo& model : page->models) names.push_back(model.name);
      if (page->next.empty()) break;
      query.page_token = page->next;
    }
    return names;
  }
  static constexpr const char* kOff = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
};

TEST_F(ModelStoreTest, GivesBackWhatWasPut) {
  const auto put = Put("cars/a.off", kOff);
  ASSERT_OK(put);
  EXPECT_TRUE(put->created);
  const auto model = store->models().Get("cars/a.off");
  ASSERT_OK(model);
  EXPECT_EQ(model->name, "cars/a.off");
  EXPECT_EQ(model->hash, HashOf(kOff));
  EXPECT_EQ(model->size, std::string(kOff).size());
  EXPECT_EQ(model->format, "off");
  EXPECT_EQ(model->created, clock.Now());
  EXPECT_FALSE(model->read_only);
  EXPECT_EQ(ReadModel("cars/a.off"), kOff);
}

TEST_F(ModelStoreTest, KeepsAModelOverARestart) {
  ASSERT_OK(Put("a", kOff));
  Open();
  EXPECT_EQ(ReadModel("a"), kOff);
}

TEST_F(ModelStoreTest, ContentOfNoKnownFormatIsAModelWithoutOne) {
  const auto put = Put("a.bin", std::string("\0\1\2\3", 4));
  ASSERT_OK(put);
  EXPECT_EQ(put->model.format, "");
  EXPECT_OK(Put("empty", "")) << "judging content is the reader's part";
}

TEST_F(ModelStoreTest, ReplacingKeepsTheDayOfCreationAndDropsTheOldContent) {
  ASSERT_OK(Put("a", "old"));
  const Timestamp before = clock.Now();
  clock.Advance(std::chrono::hours(1));
  const auto put = Put("a", "new");
  ASSERT_OK(put);
  EXPECT_FALSE(put->created);
  EXPECT_EQ(put->model.created, before);
  EXPECT_EQ(put->model.modified, clock.Now());
  EXPECT_EQ(ReadModel("a"), "new");
  EXPECT_EQ(Files("blobs"), Names{BlobStore::PathOf(HashOf("new"))});
}

TEST_F(ModelStoreTest, AConditionThatDoesNotHoldChangesNothing) {
  EXPECT_FAILS(ErrorCode::kConflict, Put("a", "x", {Kind::kMatches, HashOf("y")}));
  EXPECT_OK(Put("a", "first", {Kind::kAbsent, {}}));
  EXPECT_FAILS(ErrorCode::kConflict, Put("a", "second", {Kind::kAbsent, {}}));
  EXPECT_FAILS(ErrorCode::kConflict, Put("a", "second", {Kind::kMatches, HashOf("x")}));
  EXPECT_FAILS(ErrorCode::kConflict, store->models().Delete("a", {Kind::kMatches, HashOf("x")}));
  EXPECT_EQ(ReadModel("a"), "first");
  EXPECT_OK(Put("a", "second", {Kind::kMatches, HashOf("first")}));
  EXPECT_OK(store->models().Delete("a", {Kind::kMatches, HashOf("second")}));
  EXPECT_EQ(Files("blobs"), Names{}) << "refused content goes too";
}

TEST_F(ModelStoreTest, OfManyPutsThatExpectNothingOneWins) {
  std::atomic<int> won = 0, refused = 0;
  std::vector<std::thread> threads;
  for (int t = 0; t < 6; ++t) {
    threads.emplace_back([&, t] {
      const auto put = Put("a", "content " + std::to_string(t), {Kind::kAbsent, {}});
      if (put) ++won;
      if (!put && put.error().code == ErrorCode::kConflict) ++refused;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(won, 1);
  EXPECT_EQ(refused, 5);
  EXPECT_EQ(Files("blobs").size(), 1u);
}

TEST_F(ModelStoreTest, UnknownAndIllFormedNamesAreToldApart) {
  EXPECT_FAILS(ErrorCode::kNotFound, store->models().Get("none"));
  EXPECT_FAILS(ErrorCode::kNotFound, store->models().Delete("none"));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, store->models().Get("../none"));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, store->models().Delete("/none"));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, Put("a\\b", "x"));
}

TEST_F(ModelStoreTest, PagesHoldEveryNameOnceInOrder) {
  Names all;
  for (int i = 0; i < 23; ++i) {
    all.push_back((i % 2 != 0 ? "cars/" : "boats/") + std::to_string(i));
    ASSERT_OK(Put(all.back(), "x"));
  }
  std::sort(all.begin(), all.end());
  for (const std::size_t size : {1, 4, 23, 24, 1000}) {
    EXPECT_EQ(ListAll({"", size, ""}), all) << "pages of " << size;
  }
  EXPECT_EQ(ListAll({"boats/", 5, ""}).size(), 12u);
  EXPECT_EQ(ListAll({"car", 100, ""}).size(), 11u);
  EXPECT_EQ(ListAll({"cars/%", 100, ""}), Names{}) << "a prefix is no pattern";
}

TEST_F(ModelStoreTest, PagesAreStableWhileModelsComeAndGo) {
  for (const char* name : {"b", "d", "f", "h"}) ASSERT_OK(Put(name, name));
  auto page = store->models().List({"", 2, ""});
  ASSERT_OK(page);
  ASSERT_OK(Put("a", "a"));  // Before the token.
  ASSERT_OK(Put("e", "e"));  // After it.
  ASSERT_OK(store->models().Delete("b"));
  ASSERT_OK(store->models().Delete("d"));  // The very one the token names.
  page = store->models().List({"", 10, page->next});
  ASSERT_OK(page);
  Names rest;
  for (const ModelInfo& model : page->models) rest.push_back(model.name);
  EXPECT_EQ(rest, (Names{"e", "f", "h"}));
}

TEST_F(ModelStoreTest, RefusesPageTokensAndSizesItDidNotMake) {
  for (const char* token : {"x", "m", "m1", "mzz", "j3132", "m61 "}) {
    EXPECT_FAILS(ErrorCode::kInvalidArgument, store->models().List({"", 10, token}));
  }
  EXPECT_FAILS(ErrorCode::kInvalidArgument, store->models().List({"", 0, ""}));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, store->models().List({"", 1001, ""}));
}

TEST_F(ModelStoreTest, FilesOfTheRepositoryAreModelsThatCannotBeChanged) {
  UseRepository();
  const auto model = store->models().Get("cars/b.off");
  ASSERT_OK(model);
  EXPECT_TRUE(model->read_only);
  EXPECT_EQ(model->hash, HashOf(kOff));
  EXPECT_EQ(model->format, "off");
  EXPECT_EQ(ReadModel("cars/b.off"), kOff);
  EXPECT_FAILS(ErrorCode::kConflict, Put("cars/b.off", "x"));
  EXPECT_FAILS(ErrorCode::kConflict, store->models().Delete("cars/b.off"));
  EXPECT_EQ(*store->models().IsReadOnly("cars/b.off"), true);
  EXPECT_EQ(*store->models().IsReadOnly("cars/none"), false);
  EXPECT_EQ(test::ReadFile(options.models + "/cars/b.off"), kOff);
}

TEST_F(ModelStoreTest, ListsFilesAndStoredModelsAsOneListWithoutRepeats) {
  UseRepository();
  for (const char* name : {"a", "cars/c", "cars/a", "z"}) ASSERT_OK(Put(name, "x"));
  for (int i = 0; i < 10; ++i) {
    test::WriteFile(options.models + "/f" + std::to_string(i), "x");
  }
  ASSERT_OK(Put("late", "stored"));
  test::WriteFile(options.models + "/late", "from outside, later");
  Names all = {"a", "cars/a", "cars/b.off", "cars/c", "late", "z"};
  for (int i = 0; i < 10; ++i) all.push_back("f" + std::to_string(i));
  std::sort(all.begin(), all.end());
  for (const std::size_t size : {1, 3, 16, 100}) {
    EXPECT_EQ(ListAll({"", size, ""}), all) << "pages of " << size;
  }
  EXPECT_EQ(ReadModel("late"), "stored");
}

TEST_F(ModelStoreTest, AChangedFileOfTheRepositoryGetsItsNewHash) {
  UseRepository();
  ASSERT_OK(store->models().Get("cars/b.off"));
  test::WriteFile(options.models + "/cars/b.off", "changed");
  const auto model = store->models().Get("cars/b.off");
  ASSERT_OK(model);
  EXPECT_EQ(model->hash, HashOf("changed"));
  EXPECT_FAILS(ErrorCode::kNotFound, store->models().OpenVersion("cars/b.off", HashOf(kOff)));
  EXPECT_OK(store->models().OpenVersion("cars/b.off", HashOf("changed")));
}

TEST_F(ModelStoreTest, AReplacedModelsOldContentOpensWhileAJobRefersToIt) {
  ASSERT_OK(Put("a", "old"));
  const auto job = store->jobs().Create({"a", HashOf("old"), "{}", "key", "", ""});
  ASSERT_OK(job);
  ASSERT_OK(Put("a", "new"));
  const auto old = store->models().OpenVersion("a", HashOf("old"));
  ASSERT_OK(old);
  EXPECT_EQ(old->info.size, 3u);
  ASSERT_OK(store->models().Delete("a"));
  EXPECT_OK(store->models().OpenVersion("a", HashOf("old")));
  ASSERT_OK(store->jobs().Cancel(job->job.id));
  EXPECT_OK(store->models().OpenVersion("a", HashOf("old"))) << "still open above";
}

}  // namespace
}  // namespace strata::server
