// Copies of what lies in a bucket: within their limit, fetched once, never wrong.
#include "server/store/blob_cache.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <barrier>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "io/output_place.h"
#include "server/store/object_place.h"
#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

class BlobCacheTest : public testing::Test {
 protected:
  void Open(std::uint64_t limit, std::uint64_t keep_free = 0) {
    cache.reset();
    auto inner = OpenFolder(AT_FDCWD, folder / "cache");
    ASSERT_OK(inner);
    auto opened = BlobCache::Open(*std::move(inner), limit, keep_free);
    ASSERT_OK(opened);
    cache = *std::move(opened);
  }
  /// Asks for the copy of `bytes`, which is fetched if need be.
  Result<BlobCache::File> Get(const std::string& bytes) {
    return cache->Get(HashOf(bytes), bytes.size(), [&, this](int fd) -> Result<void> {
      ++fetched;
      std::uint64_t at = 0;
      EXPECT_EQ(io::WriteAll(fd, bytes, at), 0);
      return {};
    });
  }
  static std::string Read(const BlobCache::File& file, std::size_t size) {
    std::string bytes(size, 0);
    const auto read = ReadFileAt(file.fd.get(), 0, bytes, "copy");
    return read ? bytes : "error: " + Why(read);
  }
  std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const auto& each : std::filesystem::directory_iterator(folder / "cache")) {
      names.push_back(each.path().filename().string());
    }
    return names;
  }

  test::TempFolder folder;
  std::unique_ptr<BlobCache> cache;
  std::atomic<int> fetched{0};
};

TEST_F(BlobCacheTest, FetchesABlobOnceAndGivesItsBytes) {
  Open(1000);
  const std::string bytes = Bytes(600, 1);
  EXPECT_FALSE(cache->Find(HashOf(bytes)));
  for (int i = 0; i < 3; ++i) {
    const auto file = Get(bytes);
    ASSERT_OK(file);
    EXPECT_EQ(Read(*file, bytes.size()), bytes);
  }
  EXPECT_TRUE(cache->Find(HashOf(bytes)));
  EXPECT_EQ(fetched, 1);
}

TEST_F(BlobCacheTest, FetchesOnceHoweverManyAskAtATime) {
  Open(1 << 20);
  const std::string bytes = Bytes(100'000, 2);
  std::barrier start(8);
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i) {
    threads.emplace_back([&] {
      start.arrive_and_wait();
      const auto file = Get(bytes);
      ASSERT_OK(file);
      EXPECT_EQ(Read(*file, bytes.size()), bytes);
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(fetched, 1);
}

TEST_F(BlobCacheTest, TheLeastRecentlyUsedGoesFirst) {
  Open(1000);
  const std::string a = Bytes(400, 1), b = Bytes(400, 2), c = Bytes(400, 3);
  ASSERT_OK(Get(a));
  ASSERT_OK(Get(b));
  ASSERT_OK(Get(a));
  ASSERT_OK(Get(c));
  EXPECT_TRUE(cache->Find(HashOf(a)));
  EXPECT_FALSE(cache->Find(HashOf(b)));
  EXPECT_TRUE(cache->Find(HashOf(c)));
  EXPECT_EQ(cache->used_bytes(), 800u);
}

TEST_F(BlobCacheTest, WhatIsOpenStaysAndWhoeverNeedsItsRoomWaits) {
  Open(1000);
  const std::string a = Bytes(800, 1), b = Bytes(800, 2);
  auto held = Get(a);
  ASSERT_OK(held);
  {
    const Meanwhile nobody([] { return true; });
    EXPECT_FAILS(ErrorCode::kCancelled, Get(b));
  }
  EXPECT_TRUE(cache->Find(HashOf(a)));
  std::thread other([&] { EXPECT_OK(Get(b)); });
  *held = {};
  other.join();
  EXPECT_FALSE(cache->Find(HashOf(a)));
}

TEST_F(BlobCacheTest, WhatIsLargerThanAllOfItIsRefusedAndNamesTheOption) {
  Open(1000);
  const auto refused = Get(Bytes(1001, 1));
  EXPECT_FAILS(ErrorCode::kOverBudget, refused);
  EXPECT_NE(refused.error().message.find("--blob-cache"), std::string::npos) << Why(refused);
  EXPECT_EQ(fetched, 0);
}

TEST_F(BlobCacheTest, WrongBytesAreRefusedAndLeaveNothing) {
  Open(1000);
  const std::string right = Bytes(300, 1);
  for (const std::string& wrong : {Bytes(300, 2), right.substr(1), right + "x"}) {
    const auto file = cache->Get(HashOf(right), right.size(), [&](int fd) -> Result<void> {
      std::uint64_t at = 0;
      EXPECT_EQ(io::WriteAll(fd, wrong, at), 0);
      return {};
    });
    EXPECT_FAILS(ErrorCode::kCorruptInput, file);
    EXPECT_EQ(Names(), std::vector<std::string>()) << wrong.size() << " bytes";
    EXPECT_EQ(cache->used_bytes(), 0u);
  }
  EXPECT_OK(Get(right));
}

TEST_F(BlobCacheTest, AFailedFetchLeavesNothingAndTheNextOneTriesAgain) {
  Open(1000);
  const std::string bytes = Bytes(300, 1);
  const auto failed = cache->Get(HashOf(bytes), bytes.size(),
                                 [](int) -> Result<void> { return FailBucketAway("test"); });
  EXPECT_FAILS(ErrorCode::kIo, failed);
  EXPECT_TRUE(IsBucketAway(failed.error())) << Why(failed);
  EXPECT_EQ(cache->used_bytes(), 0u);
  EXPECT_OK(Get(bytes));
}

TEST_F(BlobCacheTest, AFullDiskIsToldAsOneOnceAllIdleCopiesAreGone) {
  Open(1000);
  const std::string idle = Bytes(300, 1), more = Bytes(300, 2);
  ASSERT_OK(Get(idle));
  Open(1000, UINT64_MAX);  // No disk has that much free.
  const auto kept = cache->Get(HashOf(idle), idle.size(), [](int) { return Result<void>(); });
  EXPECT_OK(kept) << "what is there needs no space";
  const auto refused = Get(more);
  EXPECT_FAILS(ErrorCode::kIo, refused);
  EXPECT_FALSE(IsBucketAway(refused.error()));
  EXPECT_NE(refused.error().message.find("are kept free"), std::string::npos) << Why(refused);
  EXPECT_EQ(Names().size(), 1u) << "the copy that is open";
}

TEST_F(BlobCacheTest, WhatAFormerProcessLeftIsHashedBeforeItsFirstUse) {
  Open(1000);
  const std::string good = Bytes(300, 1), bad = Bytes(300, 2);
  ASSERT_OK(Get(good));
  ASSERT_OK(Get(bad));
  cache.reset();
  std::fstream(folder / ("cache/" + HashOf(bad)), std::ios::in | std::ios::out) << '?';
  std::ofstream(folder / "cache/draft.part") << "half";
  Open(1000);
  EXPECT_EQ(cache->used_bytes(), 600u);
  EXPECT_FALSE(cache->Find(HashOf(good))) << "not known to be right yet";
  fetched = 0;
  for (const std::string& bytes : {good, bad}) {
    const auto file = Get(bytes);
    ASSERT_OK(file);
    EXPECT_EQ(Read(*file, bytes.size()), bytes);
  }
  EXPECT_EQ(fetched, 1) << "the damaged one";
  EXPECT_EQ(Names().size(), 2u);
}

TEST_F(BlobCacheTest, ASmallerLimitThanTheFormerProcesssIsKept) {
  Open(1000);
  const std::string a = Bytes(400, 1), b = Bytes(400, 2);
  ASSERT_OK(Get(a));
  ASSERT_OK(Get(b));
  Open(500);
  EXPECT_LE(cache->used_bytes(), 500u);
  EXPECT_EQ(Names().size(), 1u);
}

TEST_F(BlobCacheTest, KeepsALinkOfAFileWhereThereIsRoom) {
  Open(1000);
  auto elsewhere = OpenFolder(AT_FDCWD, folder / "elsewhere");
  ASSERT_OK(elsewhere);
  const std::string small = Bytes(700, 1), large = Bytes(2000, 2);
  std::ofstream(folder / "elsewhere/small") << small;
  std::ofstream(folder / "elsewhere/large") << large;
  cache->Keep(*elsewhere, "small", HashOf(small), small.size());
  cache->Keep(*elsewhere, "large", HashOf(large), large.size());
  unlinkat(elsewhere->get(), "small", 0);
  const auto file = cache->Find(HashOf(small));
  ASSERT_TRUE(file);
  EXPECT_EQ(Read(*file, small.size()), small);
  EXPECT_FALSE(cache->Find(HashOf(large)));
}

}  // namespace
}  // namespace strata::server
