// What the tests of the stores share: a data folder, a clock that they move, contents.
#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "io/sha256.h"
#include "server/store/store.h"
#include "tests/support/temp_folder.h"

namespace strata::server {

/// Stands still unless moved. Threads: any.
class ManualClock final : public Clock {
 public:
  Timestamp Now() const override { return FromMillis(millis_); }
  void Advance(Milliseconds by) { millis_ += by.count(); }

 private:
  std::atomic<std::int64_t> millis_{1'700'000'000'000};
};

template <class T>
std::string Why(const Result<T>& result) {
  return result ? "no error" : result.error().message;
}

#define ASSERT_OK(result) ASSERT_TRUE(result) << Why(result)
#define EXPECT_OK(result) EXPECT_TRUE(result) << Why(result)
/// That `result` is an error of this code; the message is shown if it is another.
#define EXPECT_FAILS(error_code, result)                         \
  do {                                                           \
    const auto& failed_ = (result);                              \
    ASSERT_FALSE(failed_) << "no error";                         \
    EXPECT_EQ(failed_.error().code, error_code) << Why(failed_); \
  } while (false)

inline std::string HashOf(const std::string& bytes) { return io::Sha256Hex(bytes); }

/// `size` bytes, other ones for another seed.
inline std::string Bytes(std::size_t size, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::string bytes(size, 0);
  for (char& c : bytes) c = static_cast<char>(random());
  return bytes;
}

/// A store in a folder of its own; with STRATA_TEST_POSTGRES, an address, in a schema of its own
/// there (tests/server/nodes/store_on_postgres_test.py): the same facts hold over both.
class StoreTest : public testing::Test {
 protected:
  StoreTest() {
    options.data = folder / "data";
    options.blobs.keep_free_bytes = 0;
    options.blobs.grace = Milliseconds(0);
    if (const char* const url = std::getenv("STRATA_TEST_POSTGRES")) {
      options.shared.emplace();
      options.shared->postgres.url = url;
      options.shared->postgres.schema = "t" + RandomId();
      options.shared->postgres.clock = &clock;
      options.shared->postgres.connections = 16;
    }
  }
  ~StoreTest() override {
    store.reset();
    if (!shared()) return;
    auto database = OpenPostgres(options.shared->postgres);
    if (database) {
      EXPECT_OK((*database)->Read().RunScript("DROP SCHEMA IF EXISTS " +
                                              options.shared->postgres.schema + " CASCADE"));
    }
  }
  bool shared() const { return options.shared.has_value(); }

  /// Also as the next process; in a shared store it finds its forerunner's leases run out.
  void Open() {
    const bool again = store != nullptr;
    store.reset();
    auto opened = Store::Open(options, clock);
    ASSERT_OK(opened);
    store = std::move(*opened);
    if (!shared() || !again) return;
    clock.Advance(options.jobs.lease);
    ASSERT_OK(store->jobs().ExpireLeases());
  }
  void SetUp() override { Open(); }

  Result<BlobPin> NewBlob(const std::string& bytes, BlobKind kind = BlobKind::kModel) {
    auto writer = store->blobs().NewBlob(kind, bytes.size());
    if (!writer) return Forward(writer);
    if (auto written = writer->Write(bytes); !written) return Forward(written);
    return writer->Commit();
  }
  Result<PutModel> Put(const std::string& name, const std::string& bytes,
                       const ModelCondition& condition = {}) {
    auto blob = NewBlob(bytes);
    if (!blob) return Forward(blob);
    return store->models().Put(name, *blob, condition);
  }
  /// A model's content, or "error: " and why there is none.
  std::string ReadModel(const std::string& name) {
    const auto model = store->models().Open(name);
    if (!model) return "error: " + Why(model);
    std::string bytes(model->info.size, 0);
    const auto read = ReadFileAt(model->fd.get(), 0, bytes, name);
    return read ? bytes : "error: " + Why(read);
  }
  /// Paths of the files below a folder of the data folder, sorted; without what tells, in a shared
  /// store, who made them.
  std::vector<std::string> Files(const std::string& inner) const {
    std::vector<std::string> files;
    const std::filesystem::path root = options.data;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(root / inner)) {
      if (!entry.is_regular_file()) continue;
      const std::string path = entry.path().lexically_relative(root).string();
      files.push_back(shared() ? path.substr(0, path.find('.')) : path);
    }
    std::sort(files.begin(), files.end());
    return files;
  }

  /// Where the blob with this content lies.
  std::string BlobFile(const std::string& bytes) const {
    std::string suffix;
    if (shared()) {
      EXPECT_OK(store->database().Read().Query(
          "SELECT file FROM blobs WHERE hash = ?",
          [&](const Row& row) { suffix = '.' + row.Text(0); }, HashOf(bytes)));
    }
    return options.data + '/' + BlobStore::PathOf(HashOf(bytes)) + suffix;
  }

  test::TempFolder folder;
  ManualClock clock;
  StoreOptions options;
  std::unique_ptr<Store> store;
};

}  // namespace strata::server
