#include "server/store/model_repository.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

using Names = std::vector<std::string>;
using Lookup = ModelRepository::Lookup;

// Both ways of looking up must give the same answers.
class RepositoryTest : public testing::TestWithParam<Lookup> {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(folder / "models/cars/small");
    test::WriteFile(folder / "secret", "secret");
    test::WriteFile(folder / "models/a.ply", "a");
    test::WriteFile(folder / "models/cars/b.obj", "bb");
    test::WriteFile(folder / "models/cars/small/c.stl", "ccc");
    auto opened = ModelRepository::Open(folder / "models", GetParam());
    ASSERT_OK(opened);
    repository = std::move(*opened);
  }
  std::string Read(const std::string& name) {
    const auto file = repository->OpenFile(name);
    if (!file) return "error " + std::to_string(static_cast<int>(file.error().code));
    std::string bytes(file->size, 0);
    EXPECT_OK(ReadFileAt(file->fd.get(), 0, bytes, name));
    return bytes;
  }
  const std::string missing = "error " + std::to_string(static_cast<int>(ErrorCode::kNotFound));
  test::TempFolder folder;
  std::unique_ptr<ModelRepository> repository;
};
INSTANTIATE_TEST_SUITE_P(, RepositoryTest, testing::Values(Lookup::kOpenat2, Lookup::kWalk),
                         [](const auto& of) {
                           return of.param == Lookup::kWalk ? "Walk" : "Openat2";
                         });

TEST_P(RepositoryTest, ReadsFilesAtEveryDepth) {
  EXPECT_EQ(Read("a.ply"), "a");
  EXPECT_EQ(Read("cars/b.obj"), "bb");
  EXPECT_EQ(Read("cars/small/c.stl"), "ccc");
}

TEST_P(RepositoryTest, NeverFollowsASymbolicLinkOrLeavesItsFolder) {
  const std::filesystem::path models = folder / "models";
  std::filesystem::create_symlink("../secret", models / "relative");
  std::filesystem::create_symlink(folder / "secret", models / "absolute");
  std::filesystem::create_symlink("a.ply", models / "inner");
  std::filesystem::create_directory_symlink("..", models / "up");
  std::filesystem::create_directory_symlink("cars", models / "vehicles");
  std::filesystem::create_directory_symlink("/proc/self/root", models / "magic");
  for (const std::string name :
       {"relative", "absolute", "inner", "up/secret", "vehicles/b.obj", "../secret",
        "cars/../../secret", "/etc/passwd", "magic/etc/passwd"}) {
    const std::string read = Read(name);
    EXPECT_TRUE(read.starts_with("error")) << name << " gives " << read;
  }
  const auto names = repository->List("", "", 100);
  ASSERT_OK(names);
  EXPECT_EQ(*names, (Names{"a.ply", "cars/b.obj", "cars/small/c.stl"}));
}

TEST_P(RepositoryTest, TakesNothingButRegularFiles) {
  ASSERT_EQ(mkfifo((folder / "models/pipe").c_str(), 0600), 0);
  EXPECT_EQ(Read("pipe"), missing) << "without waiting for a writer";
  EXPECT_EQ(Read("cars"), missing);
  EXPECT_EQ(Read("none"), missing);
  EXPECT_EQ(Read("a.ply/x"), missing);
  EXPECT_EQ(Read(std::string(300, 'n')), missing);
}

TEST_P(RepositoryTest, ASwappedFolderNeverGivesTheSecret) {
  const std::filesystem::path models = folder / "models";
  std::filesystem::create_directory(models / "swap");
  test::WriteFile(models / "swap/secret", "harmless");
  std::filesystem::create_directory_symlink("..", models / "link");
  std::atomic<bool> done = false;
  std::thread swapper([&] {
    while (!done) {
      std::filesystem::rename(models / "swap", models / "away");
      std::filesystem::rename(models / "link", models / "swap");
      std::filesystem::rename(models / "swap", models / "link");
      std::filesystem::rename(models / "away", models / "swap");
    }
  });
  // The bound is for a machine so busy that one of the threads does not come to run.
  const auto bound = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  int harmless = 0, refused = 0;
  for (int i = 0; i < 20'000 || harmless == 0 || refused == 0; ++i) {
    if (std::chrono::steady_clock::now() > bound) break;
    const auto file = repository->OpenFile("swap/secret");
    if (!file) {
      ++refused;
      continue;
    }
    std::string bytes(file->size, 0);
    EXPECT_OK(ReadFileAt(file->fd.get(), 0, bytes, "swap/secret"));
    EXPECT_EQ(bytes, "harmless");
    ++harmless;
  }
  done = true;
  swapper.join();
  EXPECT_GT(harmless, 0);
  EXPECT_GT(refused, 0);
}

TEST_P(RepositoryTest, ListsEveryNameOnceInOrderWhateverThePageSize) {
  Names all;
  for (int i = 0; i < 60; ++i) {
    const std::string name =
        "d" + std::to_string(i % 7) + (i % 2 != 0 ? "/e" : "") + "/f" + std::to_string(i) + ".ply";
    std::filesystem::create_directories(
        (std::filesystem::path(folder / "models") / name).parent_path());
    test::WriteFile((folder / "models/") + name, "x");
    all.push_back(name);
  }
  test::WriteFile(folder / "models/.hidden", "x");
  test::WriteFile(folder / "models/d0-beside", "x");  // '-' sorts before '/'.
  all.insert(all.end(), {"a.ply", "cars/b.obj", "cars/small/c.stl", "d0-beside"});
  std::sort(all.begin(), all.end());
  for (const std::size_t size : {1, 2, 7, 64, 1000}) {
    Names listed;
    for (std::string after;;) {
      const auto page = repository->List("", after, size);
      ASSERT_OK(page);
      if (page->empty()) break;
      listed.insert(listed.end(), page->begin(), page->end());
      after = page->back();
    }
    EXPECT_EQ(listed, all) << "pages of " << size;
  }
  const auto with_prefix = repository->List("cars/s", "", 10);
  ASSERT_OK(with_prefix);
  EXPECT_EQ(*with_prefix, Names{"cars/small/c.stl"});
}

TEST_P(RepositoryTest, TheFingerprintTellsAChangedFile) {
  const auto before = repository->OpenFile("a.ply");
  ASSERT_OK(before);
  test::WriteFile(folder / "models/a.ply", "other");
  const auto after = repository->OpenFile("a.ply");
  ASSERT_OK(after);
  EXPECT_NE(before->fingerprint, after->fingerprint);
  EXPECT_FALSE(after->settled) << "it may change again within the file system's tick";
}

}  // namespace
}  // namespace strata::server
