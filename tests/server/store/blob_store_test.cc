#include "server/store/blob_store.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

using Names = std::vector<std::string>;
using BlobStoreTest = StoreTest;

TEST_F(BlobStoreTest, NamesContentByItsSha256) {
  const std::string bytes = Bytes(300'000, 1);
  const auto pin = NewBlob(bytes);
  ASSERT_OK(pin);
  EXPECT_EQ(pin->hash(), HashOf(bytes));
  EXPECT_EQ(Files("blobs"), Names{BlobStore::PathOf(HashOf(bytes))});
  EXPECT_TRUE(test::ReadFile(BlobFile(bytes)) == bytes);
  EXPECT_EQ(Files("incoming"), Names{});
}

TEST_F(BlobStoreTest, KeepsEqualContentOnce) {
  ASSERT_OK(Put("a", "same"));
  ASSERT_OK(Put("b", "same"));
  EXPECT_EQ(Files("blobs").size(), 1u);
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 4u);
  ASSERT_OK(store->models().Delete("a"));
  EXPECT_EQ(Files("blobs").size(), 1u) << "b still refers to it";
  ASSERT_OK(store->models().Delete("b"));
  EXPECT_EQ(Files("blobs"), Names{});
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 0u);
}

TEST_F(BlobStoreTest, LeavesNothingWithoutCommit) {
  {
    auto writer = store->blobs().NewBlob(BlobKind::kModel, 10);
    ASSERT_OK(writer);
    ASSERT_OK(writer->Write("12345"));
    EXPECT_EQ(Files("incoming").size(), 1u);
    EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 10u);
  }
  EXPECT_EQ(Files("incoming"), Names{});
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 0u);
}

TEST_F(BlobStoreTest, ABlobThatNothingRefersToGoesWithItsLastPin) {
  auto first = NewBlob("content");
  ASSERT_OK(first);
  auto second = store->blobs().Pin(first->hash());
  ASSERT_OK(second);
  *first = BlobPin();
  EXPECT_EQ(Files("blobs").size(), 1u);
  *second = BlobPin();
  EXPECT_EQ(Files("blobs"), Names{});
}

TEST_F(BlobStoreTest, AnOpenReaderKeepsADeletedModelsContent) {
  ASSERT_OK(Put("a", "content"));
  auto reader = store->blobs().OpenBlob(HashOf("content"));
  ASSERT_OK(reader);
  ASSERT_OK(store->models().Delete("a"));
  std::string bytes(7, 0);
  ASSERT_OK(reader->ReadAt(0, bytes));
  EXPECT_EQ(bytes, "content");
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 7u) << "the disk is still taken";
  *reader = BlobReader{};
  EXPECT_EQ(Files("blobs"), Names{});
}

TEST_F(BlobStoreTest, RefusesWhatIsOverTheLimitBeforeWriting) {
  options.blobs.model_bytes = 1000;
  Open();
  ASSERT_OK(Put("a", Bytes(600, 1)));
  const auto over = store->blobs().NewBlob(BlobKind::kModel, 401);
  EXPECT_FAILS(ErrorCode::kOverBudget, over);
  EXPECT_EQ(over.error().message, "disk for models: 401 bytes wanted, 400 left of 1000");
  EXPECT_EQ(Files("incoming"), Names{});
  EXPECT_OK(Put("b", Bytes(400, 2))) << "what fits is taken";
}

TEST_F(BlobStoreTest, RefusesUnannouncedBytesAtTheLimitAndNotBefore) {
  options.blobs.model_bytes = 5000;
  Open();
  auto writer = store->blobs().NewBlob(BlobKind::kModel);
  ASSERT_OK(writer);
  ASSERT_OK(writer->Write(Bytes(5000, 1)));
  EXPECT_FAILS(ErrorCode::kOverBudget, writer->Write("x"));
  EXPECT_FAILS(ErrorCode::kInternal, writer->Commit());
  EXPECT_EQ(Files("incoming"), Names{});
}

TEST_F(BlobStoreTest, RefusesANumberOfBytesOtherThanAnnounced) {
  auto writer = store->blobs().NewBlob(BlobKind::kModel, 4);
  ASSERT_OK(writer);
  EXPECT_FAILS(ErrorCode::kInvalidArgument, writer->Write("12345"));
  auto shorter = store->blobs().NewBlob(BlobKind::kModel, 4);
  ASSERT_OK(shorter);
  ASSERT_OK(shorter->Write("123"));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, shorter->Commit());
}

TEST_F(BlobStoreTest, LeavesTheAskedSpaceOnTheDiskFree) {
  options.blobs.keep_free_bytes = std::uint64_t{1} << 60;
  Open();
  EXPECT_FAILS(ErrorCode::kIo, store->blobs().NewBlob(BlobKind::kModel, 1));
}

TEST_F(BlobStoreTest, ImportTakesAFinishedFileAndNothingElse) {
  test::WriteFile(store->folder().incoming_path() + "/result", "from a child");
  const auto pin = store->blobs().Import("result", BlobKind::kResult);
  ASSERT_OK(pin);
  EXPECT_EQ(pin->hash(), HashOf("from a child"));
  EXPECT_EQ(Files("incoming"), Names{});
  std::filesystem::create_symlink("/etc/passwd", store->folder().incoming_path() + "/link");
  EXPECT_FALSE(store->blobs().Import("link", BlobKind::kResult));
  ASSERT_EQ(mkfifo((store->folder().incoming_path() + "/pipe").c_str(), 0600), 0);
  EXPECT_FAILS(ErrorCode::kUnsupported, store->blobs().Import("pipe", BlobKind::kResult));
  EXPECT_FAILS(ErrorCode::kNotFound, store->blobs().Import("none", BlobKind::kResult));
}

TEST_F(BlobStoreTest, OpenRemovesWhatNoRowNamesAndKeepsTheRest) {
  if (shared())
    GTEST_SKIP() << "what others may be at is left alone: see RemovesTheLeftoversOfTheDead";
  ASSERT_OK(Put("kept", "kept"));
  const std::string orphan = BlobStore::PathOf(HashOf("orphan"));
  std::filesystem::create_directories(
      std::filesystem::path(options.data + "/" + orphan).parent_path());
  test::WriteFile(options.data + "/" + orphan, "orphan");
  test::WriteFile(options.data + "/incoming/left", "left");
  test::WriteFile(options.data + "/uploads/stranger", "left");
  ASSERT_OK(store->database().Read().Run("INSERT INTO blobs (hash, size, kind) VALUES (?, 6, 0)",
                                         HashOf("orphan")));
  Open();
  EXPECT_EQ(Files("blobs"), Names{BlobStore::PathOf(HashOf("kept"))});
  EXPECT_EQ(Files("incoming"), Names{});
  EXPECT_EQ(Files("uploads"), Names{});
  EXPECT_EQ(store->blobs().recovery().orphan_files, 1u);
  EXPECT_EQ(store->blobs().recovery().unreferenced, 1u);
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 4u);
}

TEST_F(BlobStoreTest, RemovesTheLeftoversOfTheDeadAndNobodyElses) {
  if (!shared()) GTEST_SKIP() << "one process alone";
  ASSERT_OK(Put("kept", "kept"));
  auto other = Store::Open(options, clock);
  ASSERT_OK(other);
  auto begun = (*other)->blobs().NewBlob(BlobKind::kModel);
  ASSERT_OK(begun);
  ASSERT_OK(begun->Write("begun"));
  ASSERT_OK(store->blobs().RemoveLeftovers());
  EXPECT_EQ(Files("incoming").size(), 1u) << "the other lives";
  // Of one that was killed: whole, named in blobs/ and without a row.
  const std::string dead = std::string(32, 'd') + ".1";
  test::WriteFile(options.data + "/incoming/" + dead, "left");
  const std::string orphan = BlobStore::PathOf(HashOf("orphan"));
  std::filesystem::create_directories(
      std::filesystem::path(options.data + "/" + orphan).parent_path());
  test::WriteFile(options.data + "/" + orphan + "." + dead, "orphan");
  test::WriteFile(options.data + "/uploads/somebody-elses", "left");
  ASSERT_OK(store->blobs().RemoveLeftovers());
  EXPECT_EQ(Files("blobs"), Names{BlobStore::PathOf(HashOf("kept"))});
  EXPECT_EQ(Files("incoming").size(), 1u);
  EXPECT_EQ(Files("uploads").size(), 1u);
}

TEST_F(BlobStoreTest, WhoWasDeclaredDeadCommitsNothingAndGoesOnUnderAnotherId) {
  if (!shared()) GTEST_SKIP() << "one process alone";
  auto sleeper = Store::Open(options, clock);
  ASSERT_OK(sleeper);
  auto writer = (*sleeper)->blobs().NewBlob(BlobKind::kModel);
  ASSERT_OK(writer);
  ASSERT_OK(writer->Write("late"));
  clock.Advance(options.shared->lease / 2);
  ASSERT_OK(store->blobs().membership().Renew());
  clock.Advance(options.shared->lease / 2);
  EXPECT_EQ(*store->blobs().membership().ExpireOthers(), 1u);
  ASSERT_OK(store->blobs().RemoveLeftovers());
  EXPECT_EQ(Files("incoming"), Names{});
  EXPECT_FALSE(writer->Commit());
  ASSERT_OK((*sleeper)->Maintain());
  auto again = (*sleeper)->blobs().NewBlob(BlobKind::kModel);
  ASSERT_OK(again);
  ASSERT_OK(again->Write("late"));
  EXPECT_OK(again->Commit());
}

TEST_F(BlobStoreTest, WhatNothingRefersToStaysForItsGrace) {
  if (!shared()) GTEST_SKIP() << "pins say who uses it";
  options.blobs.grace = std::chrono::minutes(1);
  Open();
  { ASSERT_OK(NewBlob("young")); }
  ASSERT_OK(store->blobs().CollectAll());
  EXPECT_EQ(Files("blobs").size(), 1u) << "another process may be about to refer to it";
  clock.Advance(std::chrono::minutes(1));
  ASSERT_OK(store->blobs().CollectAll());
  EXPECT_EQ(Files("blobs"), Names{});
}

TEST_F(BlobStoreTest, DamageFromOutsideIsFoundNamedAndHealedByTheSameContent) {
  ASSERT_OK(Put("cut", "content"));
  for (const bool remove : {false, true}) {
    const std::string path = BlobFile("content");
    if (remove) {
      std::filesystem::remove(path);
    } else {
      test::WriteFile(path, "cont");
    }
    Open();
    if (!shared()) {
      EXPECT_EQ(store->blobs().recovery().damaged, Names{HashOf("content")});
    }
    const auto opened = store->models().Open("cut");
    EXPECT_FAILS(ErrorCode::kIo, opened);
    EXPECT_NE(opened.error().message.find(BlobStore::PathOf(HashOf("content"))), std::string::npos)
        << Why(opened);
    ASSERT_OK(Put("cut", "content"));
    EXPECT_EQ(ReadModel("cut"), "content");
  }
}

TEST_F(BlobStoreTest, ManyThreadsWritingAndDroppingTheSameContentLoseNothing) {
  ASSERT_OK(Put("kept", "shared 0"));
  std::atomic<int> failures = 0;
  const auto work = [&](int who) {
    for (int i = 0; i < 25; ++i) {
      const std::string bytes = "shared " + std::to_string((i + who) % 3);
      auto pin = NewBlob(bytes);
      auto reader = pin ? store->blobs().OpenBlob(pin->hash()) : Result<BlobReader>();
      std::string read(bytes.size(), 0);
      if (!reader || !reader->ReadAt(0, read) || read != bytes) ++failures;
    }
  };
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) threads.emplace_back(work, t);
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(failures, 0);
  EXPECT_EQ(Files("blobs"), Names{BlobStore::PathOf(HashOf("shared 0"))});
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 8u);
}

}  // namespace
}  // namespace strata::server
