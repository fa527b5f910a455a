// Errors of the system, put in by the linker in place of its calls (--wrap).
#include <errno.h>
#include <gtest/gtest.h>
#include <sys/types.h>

#include "tests/server/store/store_fixture.h"

namespace {

// How many calls go through before one fails, -1: none fails.
struct Fault {
  int countdown = -1;
  int error = EIO;
  bool Strikes() {
    if (countdown < 0 || countdown-- > 0) return false;
    errno = error;
    return true;
  }
};
Fault fsync_fault, fdatasync_fault, linkat_fault, pread_fault, write_fault;

}  // namespace

extern "C" {
int __real_fsync(int);
int __wrap_fsync(int fd) { return fsync_fault.Strikes() ? -1 : __real_fsync(fd); }
int __real_fdatasync(int);
int __wrap_fdatasync(int fd) { return fdatasync_fault.Strikes() ? -1 : __real_fdatasync(fd); }
int __real_linkat(int, const char*, int, const char*, int);
int __wrap_linkat(int from, const char* name, int to, const char* new_name, int flags) {
  return linkat_fault.Strikes() ? -1 : __real_linkat(from, name, to, new_name, flags);
}
ssize_t __real_pread(int, void*, size_t, off_t);
ssize_t __wrap_pread(int fd, void* out, size_t size, off_t offset) {
  return pread_fault.Strikes() ? -1 : __real_pread(fd, out, size, offset);
}
ssize_t __real_write(int, const void*, size_t);
ssize_t __wrap_write(int fd, const void* bytes, size_t size) {
  return write_fault.Strikes() ? -1 : __real_write(fd, bytes, size);
}
}

namespace strata::server {
namespace {

class FaultsTest : public StoreTest {
 protected:
  void TearDown() override {
    fsync_fault = fdatasync_fault = linkat_fault = pread_fault = write_fault = Fault{};
    store.reset();
  }
  // `name` must not be there, nor any trace of it; and the next try must succeed.
  void ExpectNothingLeft(const std::string& name, const std::string& bytes) {
    EXPECT_FAILS(ErrorCode::kNotFound, store->models().Get(name));
    EXPECT_TRUE(Files("incoming").empty());
    EXPECT_TRUE(Files("blobs").empty());
    EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 0u);
    EXPECT_OK(Put(name, bytes));
    EXPECT_EQ(ReadModel(name), bytes);
  }
};

TEST_F(FaultsTest, AFailedSyncOfABlobLeavesNothing) {
  // The file's, and the folders'.
  for (int call = 0; call < 3; ++call) {
    const std::string name = "m" + std::to_string(call), bytes = Bytes(5000, call);
    fsync_fault.countdown = call;
    const auto put = Put(name, bytes);
    EXPECT_FAILS(ErrorCode::kIo, put);
    EXPECT_NE(put.error().message.find("Input/output error"), std::string::npos) << Why(put);
    ExpectNothingLeft(name, bytes);
    ASSERT_OK(store->models().Delete(name));
  }
}

TEST_F(FaultsTest, AFailedLinkOfABlobLeavesNothing) {
  linkat_fault.countdown = 0;
  EXPECT_FAILS(ErrorCode::kIo, Put("m", "bytes"));
  ExpectNothingLeft("m", "bytes");
}

TEST_F(FaultsTest, AFailedWriteOfABlobNamesTheByteAndLeavesNothing) {
  write_fault.countdown = 1;
  {
    auto writer = store->blobs().NewBlob(BlobKind::kModel);
    ASSERT_OK(writer);
    ASSERT_OK(writer->Write("12345"));
    const auto written = writer->Write("67890");
    EXPECT_FAILS(ErrorCode::kIo, written);
    EXPECT_NE(written.error().message.find("byte 5: "), std::string::npos) << Why(written);
    EXPECT_FAILS(ErrorCode::kInternal, writer->Commit());
  }
  ExpectNothingLeft("m", "1234567890");
}

TEST_F(FaultsTest, AFailedReadNamesTheByte) {
  ASSERT_OK(Put("m", "bytes"));
  const auto reader = store->blobs().OpenBlob(HashOf("bytes"));
  ASSERT_OK(reader);
  pread_fault.countdown = 0;
  std::string bytes(2, 0);
  const auto read = reader->ReadAt(3, bytes);
  EXPECT_FAILS(ErrorCode::kIo, read);
  EXPECT_NE(read.error().message.find("byte 3: cannot read: Input/output error"), std::string::npos)
      << Why(read);
}

TEST_F(FaultsTest, BytesOfAnUploadThatWereNotSyncedDoNotCount) {
  const auto made = store->uploads().Create({"m", 10, ""});
  ASSERT_OK(made);
  {
    auto append = store->uploads().Append(made->id, 0);
    ASSERT_OK(append->Write("12345"));
    fdatasync_fault.countdown = 0;
    EXPECT_FAILS(ErrorCode::kIo, append->Finish());
  }
  EXPECT_EQ(store->uploads().Head(made->id)->offset, 0u);
  auto append = store->uploads().Append(made->id, 0);
  ASSERT_OK(append);
  ASSERT_OK(append->Write("abcdefghij"));
  ASSERT_OK(append->Finish());
  EXPECT_EQ(ReadModel("m"), "abcdefghij");
}

TEST_F(FaultsTest, ACompleteUploadThatCouldNotBeStoredIsStoredByTheNextHead) {
  for (Fault* fault : {&linkat_fault, &fsync_fault}) {
    const auto made = store->uploads().Create({"m", 5, ""});
    ASSERT_OK(made);
    {
      auto append = store->uploads().Append(made->id, 0);
      ASSERT_OK(append->Write("12345"));
      fault->countdown = 0;
      EXPECT_FAILS(ErrorCode::kIo, append->Finish());
    }
    EXPECT_FAILS(ErrorCode::kNotFound, store->models().Get("m"));
    const auto head = store->uploads().Head(made->id);
    ASSERT_OK(head);
    EXPECT_EQ(head->hash, HashOf("12345"));
    EXPECT_EQ(ReadModel("m"), "12345");
    ASSERT_OK(store->models().Delete("m"));
    EXPECT_TRUE(Files("uploads").empty());
  }
}

TEST_F(FaultsTest, AnEmptyUploadThatCouldNotBeStoredIsStoredByTheNextStart) {
  linkat_fault.countdown = 0;
  EXPECT_FAILS(ErrorCode::kIo, store->uploads().Create({"m", 0, ""}));
  Open();
  EXPECT_EQ(ReadModel("m"), "");
  EXPECT_TRUE(Files("uploads").empty());
}

TEST_F(FaultsTest, AnUploadThatCouldNotBeMadeLeavesNothing) {
  fsync_fault.countdown = 0;
  EXPECT_FAILS(ErrorCode::kIo, store->uploads().Create({"m", 5, ""}));
  EXPECT_TRUE(Files("uploads").empty());
  EXPECT_EQ(store->blobs().budget(BlobKind::kModel).used(), 0u);
}

}  // namespace
}  // namespace strata::server
