// A full disk: clear errors, nothing lost, and all is well when space returns.
#include <gtest/gtest.h>

#include <fstream>

#include "tests/server/store/store_fixture.h"
#include "tests/support/fixed_disk.h"

namespace strata::server {
namespace {

class DiskFullTest : public StoreTest {
 protected:
  void SetUp() override {
    if (!disk.failure().empty()) GTEST_SKIP() << disk.failure();
    options.data = disk / "data";
    Open();
  }
  void TearDown() override { store.reset(); }

  // Writes until nothing more fits.
  void FillDisk() {
    std::ofstream ballast(disk / "ballast", std::ios::binary);
    for (std::size_t size = 1 << 16; size > 0; size /= 2) {
      while (ballast.write(Bytes(size, 1).data(), static_cast<std::streamsize>(size)) &&
             ballast.flush()) {
      }
      ballast.clear();
    }
  }
  void EmptyDisk() { std::filesystem::remove(disk / "ballast"); }
  JobRequest Request(const std::string& text) {
    return {"kept", HashOf("kept"), text, HashOf(text), "", ""};
  }

  test::FixedDisk disk{std::uint64_t{4} << 20};
};

TEST_F(DiskFullTest, AModelThatDoesNotFitIsRefusedAndLeavesNothing) {
  ASSERT_OK(Put("kept", "kept"));
  auto writer = store->blobs().NewBlob(BlobKind::kModel);
  ASSERT_OK(writer);
  FillDisk();
  const auto written = writer->Write(Bytes(100'000, 2));
  ASSERT_FALSE(written);
  const bool clear = written.error().code == ErrorCode::kOverBudget ||
                     written.error().message.find("No space left") != std::string::npos;
  EXPECT_TRUE(clear) << Why(written);
  EXPECT_TRUE(Files("incoming").empty());
  EXPECT_EQ(ReadModel("kept"), "kept") << "reading needs no space";
  EXPECT_FAILS(ErrorCode::kIo, store->blobs().NewBlob(BlobKind::kModel, 100'000));
  EmptyDisk();
  EXPECT_OK(Put("new", Bytes(100'000, 2)));
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 100'004u);
}

TEST_F(DiskFullTest, AnUploadGoesOnWhereItWasWhenSpaceReturns) {
  const std::string bytes = Bytes(300'000, 3);
  const auto made = store->uploads().Create({"m", bytes.size(), ""});
  ASSERT_OK(made);
  {
    auto append = store->uploads().Append(made->id, 0);
    ASSERT_OK(append->Write(bytes.substr(0, 100'000)));
    ASSERT_OK(append->Finish());
  }
  FillDisk();
  {
    auto append = store->uploads().Append(made->id, 100'000);
    ASSERT_OK(append);
    const auto written = append->Write(bytes.substr(100'000));
    EXPECT_FAILS(ErrorCode::kIo, written);
    EXPECT_NE(written.error().message.find("No space left"), std::string::npos) << Why(written);
  }
  EmptyDisk();
  const auto info = store->uploads().Head(made->id);
  ASSERT_OK(info);
  EXPECT_GE(info->offset, 100'000u);
  auto append = store->uploads().Append(made->id, info->offset);
  ASSERT_OK(append);
  ASSERT_OK(append->Write(bytes.substr(info->offset)));
  ASSERT_OK(append->Finish());
  EXPECT_EQ(ReadModel("m"), bytes);
}

TEST_F(DiskFullTest, JobsThatCannotBeWrittenAreRefusedAndThoseMadeAreKept) {
  const auto first = store->jobs().Create(Request("first"));
  ASSERT_OK(first);
  FillDisk();
  std::vector<std::string> made;
  Result<CreatedJob> refused;
  // SQLite's log has room for a few more.
  for (int i = 0; i < 3000 && refused; ++i) {
    refused = store->jobs().Create(Request(std::string(4000, 'x') + std::to_string(i)));
    if (refused) made.push_back(refused->job.id);
  }
  ASSERT_FALSE(refused);
  EXPECT_TRUE(refused.error().code == ErrorCode::kIo ||
              refused.error().code == ErrorCode::kOverBudget)
      << Why(refused);
  EXPECT_OK(store->jobs().Get(first->job.id));
  EXPECT_EQ(store->jobs().queued(), 1 + made.size());
  EmptyDisk();
  EXPECT_OK(store->jobs().Create(Request("second")));
  Open();
  for (const std::string& id : made) EXPECT_OK(store->jobs().Get(id));
  EXPECT_EQ(store->jobs().queued(), 2 + made.size());
}

TEST_F(DiskFullTest, AJobWhoseEndCannotBeWrittenIsStillRunningAndEndsLater) {
  ASSERT_OK(store->jobs().Create(Request("job")));
  const auto claimed = store->jobs().Claim("worker");
  ASSERT_OK(claimed);
  auto pin = NewBlob("result", BlobKind::kResult);
  ASSERT_OK(pin);
  FillDisk();
  // Until SQLite's log has no room.
  Result<bool> beat = true;
  for (int i = 0; i < 3000 && beat; ++i) {
    beat = store->jobs().Heartbeat((*claimed)->claim, {std::string(4000, 'x'), 1, 2});
  }
  EXPECT_FAILS(ErrorCode::kIo, beat);
  JobResult result;
  result.summary = std::string(60'000, 's');
  EXPECT_FAILS(ErrorCode::kIo, store->jobs().Succeed((*claimed)->claim, *pin, result));
  EXPECT_EQ(store->jobs().Get((*claimed)->job.id)->state, JobState::kRunning);
  EXPECT_EQ(store->jobs().running(), 1u);
  EmptyDisk();
  ASSERT_OK(store->jobs().Succeed((*claimed)->claim, *pin, result));
  *pin = BlobPin();
  Open();
  const auto job = store->jobs().Get((*claimed)->job.id);
  EXPECT_EQ(job->state, JobState::kSucceeded);
  EXPECT_OK(store->blobs().OpenBlob(job->result->hash));
}

TEST_F(DiskFullTest, SpaceKeptFreeLetsJobsAndDeletionsThroughWhileContentIsRefused) {
  options.blobs.keep_free_bytes = 2 << 20;  // More than SQLite's log of what follows takes.
  Open();
  ASSERT_OK(Put("a", Bytes(1'500'000, 1)));
  Result<PutModel> put;
  for (int i = 0; i < 100 && put; ++i) {
    put = Put("m" + std::to_string(i), Bytes(200'000, static_cast<std::uint64_t>(i) + 10));
  }
  EXPECT_FAILS(ErrorCode::kIo, put);
  EXPECT_NE(put.error().message.find("kept free"), std::string::npos) << Why(put);
  for (int i = 0; i < 50; ++i) ASSERT_OK(store->jobs().Create(Request(std::to_string(i))));
  ASSERT_OK(store->models().Delete("a"));
  EXPECT_OK(Put("b", Bytes(200'000, 200)));
}

TEST_F(DiskFullTest, ContentThatAFullDiskKeptIsCollectedByMaintain) {
  auto pin = NewBlob(Bytes(50'000, 1));
  ASSERT_OK(pin);
  FillDisk();
  Result<void> filled;
  for (int i = 0; i < 3000 && filled; ++i) {
    const auto made = store->jobs().Create(Request(std::string(4000, 'x') + std::to_string(i)));
    if (!made) filled = Forward(made);
  }
  ASSERT_FALSE(filled);
  *pin = BlobPin();
  EmptyDisk();
  ASSERT_OK(store->Maintain());
  EXPECT_TRUE(Files("blobs").empty());
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 0u);
}

}  // namespace
}  // namespace strata::server
