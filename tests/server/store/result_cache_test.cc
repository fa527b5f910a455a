#include "server/store/result_cache.h"

#include <gtest/gtest.h>

#include <latch>
#include <set>
#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

constexpr Milliseconds kNoWait{0};
constexpr Milliseconds kLong = std::chrono::seconds(20);  // A bound: what is waited for comes.

class ResultCacheTest : public StoreTest {
 protected:
  ResultCache& cache() { return store->results(); }
  Result<void> Fill(const std::string& key, const std::string& bytes) {
    auto answer = cache().Enter(key);
    if (!answer) return Forward(answer);
    if (!answer->lead) return Fail(ErrorCode::kInternal, "not to be computed");
    const auto blob = NewBlob(bytes, BlobKind::kResult);
    if (!blob) return Forward(blob);
    return answer->lead->Publish(*blob, "text/plain", "summary of " + key);
  }
  bool Has(const std::string& key) {
    const auto found = cache().Lookup(key);
    EXPECT_OK(found);
    return found && found->has_value();
  }
};

TEST(ResultKeys, DifferWithEveryPart) {
  const ResultKeyParts base{"hash", "options", 1, "0.1"};
  std::set<std::string> keys = {ResultKey(base)};
  EXPECT_TRUE(keys.insert(ResultKey({"hash2", "options", 1, "0.1"})).second);
  EXPECT_TRUE(keys.insert(ResultKey({"hash", "options2", 1, "0.1"})).second);
  EXPECT_TRUE(keys.insert(ResultKey({"hash", "options", 2, "0.1"})).second);
  EXPECT_TRUE(keys.insert(ResultKey({"hash", "options", 1, "0.2"})).second);
  EXPECT_TRUE(keys.insert(ResultKey({"hashoptions", "", 1, "0.1"})).second);
  EXPECT_FALSE(keys.insert(ResultKey(base)).second);
}

TEST_F(ResultCacheTest, AResultIsThereForTheNextAndAfterARestart) {
  ASSERT_OK(Fill("key", "samples"));
  for (int i = 0; i < 2; ++i) {
    auto answer = cache().Enter("key");
    ASSERT_OK(answer);
    ASSERT_TRUE(answer->hit);
    std::string bytes(answer->hit->content.size(), 0);
    ASSERT_OK(answer->hit->content.ReadAt(0, bytes));
    EXPECT_EQ(bytes, "samples");
    EXPECT_EQ(answer->hit->content.pin.hash(), HashOf("samples"));
    EXPECT_EQ(answer->hit->media_type, "text/plain");
    EXPECT_EQ(answer->hit->summary, "summary of key");
    answer->hit.reset();
    Open();
  }
}

TEST_F(ResultCacheTest, TheLeastRecentlyUsedGoesFirst) {
  options.blobs.result_bytes = 3000;
  Open();
  for (const char* key : {"a", "b", "c"}) ASSERT_OK(Fill(key, key + Bytes(999, 1)));
  EXPECT_TRUE(Has("a"));
  ASSERT_OK(Fill("d", "d" + Bytes(999, 1)));
  EXPECT_TRUE(Has("a")) << "used lately";
  EXPECT_FALSE(Has("b"));
  EXPECT_TRUE(Has("c"));
  EXPECT_EQ(cache().counts().evictions, 1u);
  EXPECT_EQ(Files("blobs").size(), 3u);
}

TEST_F(ResultCacheTest, TheOrderOfUseOutlivesARestart) {
  options.blobs.result_bytes = 2000;
  Open();
  ASSERT_OK(Fill("a", "a" + Bytes(999, 1)));
  ASSERT_OK(Fill("b", "b" + Bytes(999, 1)));
  EXPECT_TRUE(Has("a"));
  Open();
  ASSERT_OK(Fill("c", "c" + Bytes(999, 1)));
  EXPECT_TRUE(Has("a"));
  EXPECT_FALSE(Has("b"));
}

TEST_F(ResultCacheTest, NothingThatIsOpenIsEvicted) {
  options.blobs.result_bytes = 2000;
  Open();
  ASSERT_OK(Fill("a", "a" + Bytes(999, 1)));
  auto open = cache().Lookup("a");
  ASSERT_OK(open);
  ASSERT_OK(Fill("b", "b" + Bytes(999, 1)));
  ASSERT_OK(Fill("c", "c" + Bytes(999, 1)));
  EXPECT_TRUE(Has("a"));
  EXPECT_FALSE(Has("b"));
  auto second = cache().Lookup("c");
  EXPECT_FAILS(ErrorCode::kOverBudget, Fill("d", "d" + Bytes(999, 1)));
  *open = std::nullopt;
  EXPECT_OK(Fill("d", "d" + Bytes(999, 1)));
  EXPECT_FALSE(Has("a"));
}

TEST_F(ResultCacheTest, NothingThatAJobRefersToIsEvicted) {
  options.blobs.result_bytes = 2000;
  Open();
  ASSERT_OK(store->jobs().Create({"m", HashOf("m"), "{}", "a", "", ""}));
  const auto claimed = store->jobs().Claim("w");
  ASSERT_OK(claimed);
  {
    auto answer = cache().Enter("a");
    const auto blob = NewBlob(Bytes(1000, 1), BlobKind::kResult);
    ASSERT_OK(answer->lead->Publish(*blob, "", ""));
    ASSERT_OK(store->jobs().Succeed((*claimed)->claim, *blob, {}));
  }
  ASSERT_OK(Fill("b", Bytes(1000, 2)));
  ASSERT_OK(Fill("c", Bytes(1000, 3)));
  EXPECT_TRUE(Has("a"));
  EXPECT_FALSE(Has("b"));
  clock.Advance(std::chrono::hours(1));
  ASSERT_OK(store->jobs().Purge(clock.Now()));
  EXPECT_TRUE(Has("c")) << "so that a is the least recently used";
  ASSERT_OK(Fill("d", Bytes(1000, 4)));
  EXPECT_FALSE(Has("a"));
}

TEST_F(ResultCacheTest, ManyEqualRequestsComputeOnce) {
  constexpr int kThreads = 8;
  std::atomic<int> computed = 0, answered = 0;
  std::latch all(kThreads);
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&] {
      all.arrive_and_wait();
      for (;;) {
        auto answer = cache().Enter("key");
        ASSERT_OK(answer);
        if (answer->hit) break;
        if (answer->lead) {
          ++computed;
          const auto blob = NewBlob("result", BlobKind::kResult);
          ASSERT_OK(answer->lead->Publish(*blob, "", ""));
        } else {
          ASSERT_TRUE(answer->wait->Wait(kLong));
          EXPECT_FALSE(answer->wait->error());
        }
      }
      ++answered;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(computed, 1);
  EXPECT_EQ(answered, kThreads);
  EXPECT_EQ(cache().counts().misses, 1u);
  EXPECT_EQ(cache().counts().hits, static_cast<std::uint64_t>(kThreads));
}

TEST_F(ResultCacheTest, ALeaderWhoGivesUpLeavesTheLeadToAnother) {
  auto first = cache().Enter("key");
  auto second = cache().Enter("key");
  ASSERT_TRUE(first->lead && second->wait);
  EXPECT_FALSE(second->wait->Wait(kNoWait));
  first->lead.reset();
  EXPECT_TRUE(second->wait->Wait(kNoWait));
  EXPECT_FALSE(second->wait->error());
  EXPECT_TRUE(cache().Enter("key")->lead);
}

TEST_F(ResultCacheTest, AFailureIsToldToAllWhoWaitAndIsNotRemembered) {
  auto first = cache().Enter("key");
  const auto second = cache().Enter("key");
  ASSERT_TRUE(first->lead && second->wait);
  first->lead->MarkFailed({ErrorCode::kCorruptInput, "byte 7"});
  EXPECT_TRUE(second->wait->Wait(kNoWait));
  EXPECT_EQ(second->wait->error()->message, "byte 7");
  EXPECT_TRUE(cache().Enter("key")->lead) << "the next may try";
}

TEST_F(ResultCacheTest, ProcessesComputeAResultOnceAndPassTheLeadOn) {
  if (!shared()) GTEST_SKIP() << "one process alone";
  auto other = Store::Open(options, clock);
  ASSERT_OK(other);
  ResultCache& theirs = (*other)->results();
  auto lead = cache().Enter("key");
  ASSERT_OK(lead);
  ASSERT_TRUE(lead->lead);
  auto waiting = theirs.Enter("key");
  ASSERT_OK(waiting);
  ASSERT_TRUE(waiting->wait);
  // The database is away just as the lead ends.
  ASSERT_OK(store->database().Read().RunScript("ALTER TABLE flights RENAME TO hidden"));
  lead->lead.reset();
  EXPECT_FALSE(waiting->wait->Wait(Milliseconds(0)));
  ASSERT_OK(store->database().Read().RunScript("ALTER TABLE hidden RENAME TO flights"));
  cache().Look();
  EXPECT_TRUE(waiting->wait->Wait(std::chrono::seconds(20)));
  EXPECT_TRUE(theirs.Enter("key")->lead);
}

TEST_F(ResultCacheTest, ADamagedResultIsComputedAgain) {
  ASSERT_OK(Fill("key", "samples"));
  std::filesystem::remove(BlobFile("samples"));
  EXPECT_FALSE(Has("key"));
  ASSERT_OK(Fill("key", "samples"));
  EXPECT_TRUE(Has("key"));
}

TEST_F(ResultCacheTest, RemovingGivesTheSpaceBack) {
  ASSERT_OK(Fill("key", "samples"));
  ASSERT_OK(cache().Remove("key"));
  EXPECT_OK(cache().Remove("key"));
  EXPECT_FALSE(Has("key"));
  EXPECT_TRUE(Files("blobs").empty());
  EXPECT_EQ(store->blobs().budget(BlobKind::kResult).used(), 0u);
}

}  // namespace
}  // namespace strata::server
