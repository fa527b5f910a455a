#include "server/store/upload_store.h"

#include <gtest/gtest.h>

#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

using Names = std::vector<std::string>;

class UploadStoreTest : public StoreTest {
 protected:
  UploadStore& uploads() { return store->uploads(); }
  std::string Create(std::optional<std::uint64_t> length, const std::string& model = "m") {
    const auto made = uploads().Create({model, length, "filename bS5wbHk="});
    EXPECT_OK(made);
    return made ? made->id : std::string();
  }
  Result<UploadInfo> Send(const std::string& id, std::uint64_t offset, const std::string& bytes,
                          std::optional<UploadChecksum> checksum = std::nullopt) {
    auto append = uploads().Append(id, offset, std::move(checksum));
    if (!append) return Forward(append);
    if (auto written = append->Write(bytes); !written) return Forward(written);
    return append->Finish();
  }
  std::uint64_t OffsetOf(const std::string& id) {
    const auto info = uploads().Head(id);
    EXPECT_OK(info);
    return info ? info->offset : UINT64_MAX;
  }
  std::uint64_t Used() {
    if (shared()) {
      EXPECT_OK(store->blobs().CountBytes());
    }
    return store->blobs().budget(BlobKind::kModel).used();
  }
  static UploadChecksum Sha1(const std::string& bytes) {
    io::Hasher hasher(io::DigestKind::kSha1);
    hasher.Update(bytes);
    return {io::DigestKind::kSha1, hasher.HexDigest()};
  }
};

TEST_F(UploadStoreTest, PartsInOrderBecomeAModel) {
  const std::string bytes = Bytes(100'000, 4);
  const std::string id = Create(bytes.size());
  EXPECT_EQ(Send(id, 0, bytes.substr(0, 40'000))->offset, 40'000u);
  EXPECT_EQ(OffsetOf(id), 40'000u);
  EXPECT_FAILS(ErrorCode::kNotFound, store->models().Get("m"));
  const auto done = Send(id, 40'000, bytes.substr(40'000));
  ASSERT_OK(done);
  EXPECT_EQ(done->hash, HashOf(bytes));
  EXPECT_EQ(ReadModel("m"), bytes);
  EXPECT_EQ(Files("uploads"), Names{});
  EXPECT_EQ(Used(), bytes.size());
  const auto head = uploads().Head(id);
  ASSERT_OK(head) << "a client whose last answer was lost asks once more";
  EXPECT_EQ(head->offset, bytes.size());
  EXPECT_EQ(head->metadata, "filename bS5wbHk=");
}

TEST_F(UploadStoreTest, AnotherOffsetIsAConflictThatNamesTheRightOne) {
  const std::string id = Create(10);
  ASSERT_OK(Send(id, 0, "12345"));
  for (const std::uint64_t offset : {0, 4, 6, 10, 11}) {
    const auto refused = Send(id, offset, "x");
    EXPECT_FAILS(ErrorCode::kConflict, refused);
    EXPECT_NE(refused.error().message.find("expected 5"), std::string::npos) << Why(refused);
  }
  EXPECT_FAILS(ErrorCode::kConflict, Send(id, UINT64_MAX, "x"));
  EXPECT_EQ(OffsetOf(id), 5u);
}

TEST_F(UploadStoreTest, BytesBeyondTheLengthAreRefusedAndWhatCameBeforeIsKept) {
  const std::string id = Create(5);
  {
    auto append = uploads().Append(id, 0);
    ASSERT_OK(append);
    ASSERT_OK(append->Write("123"));
    EXPECT_FAILS(ErrorCode::kInvalidArgument, append->Write("456"));
    EXPECT_FAILS(ErrorCode::kInternal, append->Write("4"));
  }
  EXPECT_EQ(OffsetOf(id), 3u);
  ASSERT_OK(Send(id, 3, "45"));
  EXPECT_EQ(ReadModel("m"), "12345");
}

TEST_F(UploadStoreTest, AClientThatGoesAwayFindsWhatItSent) {
  const std::string id = Create(100);
  {
    auto append = uploads().Append(id, 0);
    ASSERT_OK(append);
    ASSERT_OK(append->Write("12345"));
  }
  EXPECT_EQ(OffsetOf(id), 5u);
  Open();
  EXPECT_EQ(OffsetOf(id), 5u) << "after a restart too";
}

TEST_F(UploadStoreTest, AClientThatGoesAwayAfterTheLastByteHasItsModel) {
  const std::string id = Create(5);
  {
    auto append = uploads().Append(id, 0);
    ASSERT_OK(append);
    ASSERT_OK(append->Write("12345"));
  }
  EXPECT_EQ(ReadModel("m"), "12345");
}

TEST_F(UploadStoreTest, ResumesAfterARestartAndHashesTheWhole) {
  const std::string bytes = Bytes(50'000, 5);
  const std::string id = Create(bytes.size());
  ASSERT_OK(Send(id, 0, bytes.substr(0, 20'000)));
  Open();
  ASSERT_OK(Send(id, 20'000, bytes.substr(20'000)));
  EXPECT_EQ(store->models().Get("m")->hash, HashOf(bytes));
}

TEST_F(UploadStoreTest, BytesBeyondTheDurableOffsetAreCutOffByARestart) {
  if (shared()) GTEST_SKIP() << "is about strata.db";
  const std::string id = Create(10);
  ASSERT_OK(Send(id, 0, "12345"));
  store.reset();
  test::WriteFile(options.data + "/uploads/" + id, "12345xyz");
  Open();
  EXPECT_EQ(OffsetOf(id), 5u);
  EXPECT_EQ(test::ReadFile(options.data + "/uploads/" + id), "12345");
  ASSERT_OK(Send(id, 5, "67890"));
  EXPECT_EQ(ReadModel("m"), "1234567890");
}

TEST_F(UploadStoreTest, ACompleteUploadThatWasNotStoredIsStoredByTheNextStart) {
  if (shared()) GTEST_SKIP() << "is about strata.db";
  const std::string id = Create(5);
  store.reset();
  {
    auto database = Database::Open(options.data + "/strata.db");
    ASSERT_OK(database);
    ASSERT_OK((*database)->Read().Run("UPDATE uploads SET \"offset\" = 5"));
  }
  test::WriteFile(options.data + "/uploads/" + id, "12345");
  Open();
  EXPECT_EQ(ReadModel("m"), "12345");
  EXPECT_EQ(uploads().Head(id)->hash, HashOf("12345"));
  EXPECT_EQ(Files("uploads"), Names{});
}

TEST_F(UploadStoreTest, ADeferredLengthIsToldOnce) {
  const std::string id = Create(std::nullopt);
  ASSERT_OK(Send(id, 0, "123"));
  EXPECT_EQ(uploads().Head(id)->length, std::nullopt);
  EXPECT_FAILS(ErrorCode::kInvalidArgument, uploads().SetLength(id, 2));
  ASSERT_OK(uploads().SetLength(id, 5));
  EXPECT_OK(uploads().SetLength(id, 5));
  EXPECT_FAILS(ErrorCode::kConflict, uploads().SetLength(id, 6));
  ASSERT_OK(Send(id, 3, "45"));
  EXPECT_EQ(ReadModel("m"), "12345");
  const std::string whole = Create(std::nullopt, "n");
  ASSERT_OK(Send(whole, 0, "abc"));
  EXPECT_OK(uploads().SetLength(whole, 3));
  EXPECT_EQ(ReadModel("n"), "abc") << "all bytes were there already";
}

TEST_F(UploadStoreTest, NoBytesAreAModelAtOnce) {
  Create(0);
  EXPECT_EQ(ReadModel("m"), "");
}

TEST_F(UploadStoreTest, AWrongChecksumDiscardsThatRequestsBytesAlone) {
  const std::string id = Create(10);
  ASSERT_OK(Send(id, 0, "12345", Sha1("12345")));
  EXPECT_FAILS(ErrorCode::kCorruptInput, Send(id, 5, "67x90", Sha1("67890")));
  EXPECT_EQ(OffsetOf(id), 5u);
  ASSERT_OK(Send(id, 5, "67890", UploadChecksum{io::DigestKind::kSha256, HashOf("67890")}));
  EXPECT_EQ(ReadModel("m"), "1234567890");
}

TEST_F(UploadStoreTest, AnUnfulfilledChecksumKeepsNothing) {
  const std::string id = Create(10);
  {
    auto append = uploads().Append(id, 0, Sha1("12345"));
    ASSERT_OK(append);
    ASSERT_OK(append->Write("123"));
  }
  EXPECT_EQ(OffsetOf(id), 0u);
  EXPECT_FAILS(ErrorCode::kInvalidArgument,
               uploads().Append(id, 0, UploadChecksum{io::DigestKind::kSha1, "12"}));
}

TEST_F(UploadStoreTest, ASecondRequestStopsTheFirstAndComesThroughLater) {
  const std::string id = Create(10);
  auto first = uploads().Append(id, 0);
  ASSERT_OK(first);
  ASSERT_OK(first->Write("123"));
  EXPECT_FAILS(ErrorCode::kConflict, uploads().Append(id, 0));
  EXPECT_FAILS(ErrorCode::kConflict, first->Write("4"));
  { const UploadAppend gone = std::move(*first); }
  EXPECT_EQ(OffsetOf(id), 3u);
  EXPECT_OK(Send(id, 3, "4567890"));
  EXPECT_EQ(ReadModel("m"), "1234567890");
}

TEST_F(UploadStoreTest, TerminatingGivesTheSpaceBack) {
  const std::string id = Create(1000);
  ASSERT_OK(Send(id, 0, "123"));
  EXPECT_EQ(Used(), 1000u);
  ASSERT_OK(uploads().Terminate(id));
  EXPECT_EQ(Used(), 0u);
  EXPECT_EQ(Files("uploads"), Names{});
  EXPECT_FAILS(ErrorCode::kNotFound, uploads().Head(id));
  EXPECT_FAILS(ErrorCode::kNotFound, uploads().Terminate(id));
  EXPECT_FAILS(ErrorCode::kNotFound, uploads().Append("../x", 0));
}

TEST_F(UploadStoreTest, ExpiresAfterItsLastByteAndNotBefore) {
  const std::string id = Create(10);
  clock.Advance(std::chrono::hours(23));
  ASSERT_OK(Send(id, 0, "123"));
  clock.Advance(std::chrono::hours(23));
  EXPECT_EQ(*uploads().RemoveExpired(), 0u);
  EXPECT_EQ(OffsetOf(id), 3u);
  clock.Advance(std::chrono::hours(1));
  EXPECT_FAILS(ErrorCode::kNotFound, uploads().Head(id));
  EXPECT_EQ(*uploads().RemoveExpired(), 1u);
  EXPECT_EQ(Files("uploads"), Names{});
  EXPECT_EQ(Used(), 0u);
}

TEST_F(UploadStoreTest, OverALimitIsRefusedBeforeAByteIsTaken) {
  options.blobs.model_bytes = 1000;
  options.uploads.max_bytes = 900;
  options.uploads.max_open = 2;
  Open();
  EXPECT_FAILS(ErrorCode::kOverBudget, uploads().Create({"m", 901, ""}));
  Create(600);
  EXPECT_FAILS(ErrorCode::kOverBudget, uploads().Create({"m", 600, ""}));
  const std::string deferred = Create(std::nullopt);
  EXPECT_FAILS(ErrorCode::kOverBudget, Send(deferred, 0, Bytes(401, 1)));
  EXPECT_FAILS(ErrorCode::kOverBudget, uploads().Create({"m", 1, ""}));  // Two are open.
  Open();
  EXPECT_EQ(Used(), 600u) << "what is reserved stays so over a restart";
}

TEST_F(UploadStoreTest, GoesOnAtAnotherProcess) {
  if (!shared()) GTEST_SKIP() << "one process alone";
  const std::string bytes = Bytes(50'000, 6);
  const std::string id = Create(bytes.size());
  ASSERT_OK(Send(id, 0, bytes.substr(0, 20'000)));
  auto other = Store::Open(options, clock);
  ASSERT_OK(other);
  UploadStore& theirs = (*other)->uploads();
  EXPECT_EQ(theirs.Head(id)->offset, 20'000u);
  {
    auto first = uploads().Append(id, 20'000);
    ASSERT_OK(first);
    ASSERT_OK(first->Write(bytes.substr(20'000, 10'000)));
    EXPECT_FAILS(ErrorCode::kConflict, theirs.Append(id, 20'000));
  }
  auto second = theirs.Append(id, 30'000);
  ASSERT_OK(second);
  ASSERT_OK(second->Write(bytes.substr(30'000)));
  ASSERT_OK(second->Finish());
  EXPECT_EQ(ReadModel("m") == bytes, true);
  EXPECT_EQ(uploads().Head(id)->hash, HashOf(bytes));
}

TEST_F(UploadStoreTest, WhoWasDeclaredDeadWritesToAFileThatNobodyReads) {
  if (!shared()) GTEST_SKIP() << "one process alone";
  const std::string bytes = Bytes(50'000, 7);
  const std::string id = Create(bytes.size());
  ASSERT_OK(Send(id, 0, bytes.substr(0, 20'000)));
  auto other = Store::Open(options, clock);
  ASSERT_OK(other);
  UploadStore& theirs = (*other)->uploads();
  {
    auto sleeper = uploads().Append(id, 20'000);
    ASSERT_OK(sleeper);
    clock.Advance(options.shared->lease / 2);
    ASSERT_OK((*other)->blobs().membership().Renew());
    clock.Advance(options.shared->lease / 2);
    EXPECT_EQ(*(*other)->blobs().membership().ExpireOthers(), 1u);
    auto taken = theirs.Append(id, 20'000);
    ASSERT_OK(taken);
    ASSERT_OK(taken->Write(bytes.substr(20'000, 10'000)));
    EXPECT_OK(sleeper->Write(std::string(10'000, 'x')));
    EXPECT_FAILS(ErrorCode::kConflict, sleeper->Finish());
    ASSERT_OK(taken->Write(bytes.substr(30'000)));
    ASSERT_OK(taken->Finish());
  }
  EXPECT_EQ(ReadModel("m") == bytes, true);
}

TEST_F(UploadStoreTest, NamesAreJudgedBeforeTheFirstByte) {
  EXPECT_FAILS(ErrorCode::kInvalidArgument, uploads().Create({"../m", 1, ""}));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, uploads().Create({"m", 1, std::string(5000, 'x')}));
}

TEST_F(UploadStoreTest, ManyUploadsAtOnceDoNotDisturbEachOther) {
  std::vector<std::thread> threads;
  std::atomic<int> failures = 0;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      const std::string bytes = Bytes(30'000, 100 + t), name = "m" + std::to_string(t);
      const std::string id = Create(bytes.size(), name);
      for (std::size_t at = 0; at < bytes.size(); at += 10'000) {
        if (!Send(id, at, bytes.substr(at, 10'000))) ++failures;
      }
      if (ReadModel(name) != bytes) ++failures;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(failures, 0);
}

}  // namespace
}  // namespace strata::server
