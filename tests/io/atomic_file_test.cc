#include "io/atomic_file.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <thread>

#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::MessageOf;
using test::ReadFile;
using test::TempFolder;
using test::WriteFile;
using Names = std::vector<std::string>;

Result<std::uint64_t> WriteWhole(const std::string& path, const std::string& bytes) {
  auto file = AtomicFile::Open(path);
  if (!file) return Forward(file);
  if (auto written = (*file)->Write(bytes); !written) return Forward(written);
  return (*file)->Finish();
}

mode_t ModeOf(const std::string& path) {
  struct stat status {};
  EXPECT_EQ(stat(path.c_str(), &status), 0) << path;
  return status.st_mode & 07777;
}

// A process that runs `body`, says that it is done by a byte, and waits to be killed.
class Child {
 public:
  template <class Body>
  explicit Child(const Body& body) {
    int ends[2];
    if (pipe(ends) != 0) ADD_FAILURE() << "no pipe";
    pid_ = fork();
    if (pid_ == 0) {
      body();
      if (write(ends[1], "x", 1) != 1) _exit(1);
      for (;;) pause();
    }
    close(ends[1]);
    char byte = 0;
    EXPECT_EQ(read(ends[0], &byte, 1), 1);
    close(ends[0]);
  }
  ~Child() { Kill(); }
  void Kill() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = 0;
  }

 private:
  pid_t pid_ = 0;
};

TEST(AtomicFile, AppearsOnlyInFinish) {
  TempFolder folder;
  auto file = AtomicFile::Open(folder / "a.ply");
  ASSERT_TRUE(file) << MessageOf(file);
  ASSERT_TRUE((*file)->Write("hello"));
  ASSERT_EQ(folder.List().size(), 1u);
  EXPECT_TRUE(folder.List()[0].starts_with(".a.ply.strata-")) << folder.List()[0];
  EXPECT_TRUE(folder.List()[0].ends_with(".part")) << folder.List()[0];
  const auto bytes = (*file)->Finish();
  ASSERT_TRUE(bytes) << MessageOf(bytes);
  EXPECT_EQ(*bytes, 5u);
  EXPECT_EQ(folder.List(), Names{"a.ply"});
  EXPECT_EQ(ReadFile(folder / "a.ply"), "hello");
}

TEST(AtomicFile, LeavesNothingWithoutFinish) {
  TempFolder folder;
  WriteFile(folder / "a", "old");
  {
    auto file = AtomicFile::Open(folder / "a");
    ASSERT_TRUE(file) << MessageOf(file);
    ASSERT_TRUE((*file)->Write(std::string(3 << 20, 'x')));
  }
  EXPECT_EQ(folder.List(), Names{"a"});
  EXPECT_EQ(ReadFile(folder / "a"), "old");
}

TEST(AtomicFile, KeepsEveryByteOfSmallAndLargeWrites) {
  TempFolder folder;
  std::string expected;
  auto file = AtomicFile::Open(folder / "a");
  ASSERT_TRUE(file) << MessageOf(file);
  for (std::size_t size : {1, 7, (1 << 20) - 9, 1, 1 << 20, 3, (1 << 20) + 1, 5'000'000, 0, 2}) {
    const std::string part(size, static_cast<char>('a' + expected.size() % 26));
    expected += part;
    ASSERT_TRUE((*file)->Write(part));
    EXPECT_EQ((*file)->size(), expected.size());
  }
  ASSERT_TRUE((*file)->Finish());
  EXPECT_TRUE(ReadFile(folder / "a") == expected);
}

TEST(AtomicFile, GivesANewFileTheUmasksModeAndKeepsAnOldOnes) {
  TempFolder folder;
  const mode_t before = umask(027);
  ASSERT_TRUE(WriteWhole(folder / "new", "x"));
  EXPECT_EQ(ModeOf(folder / "new"), mode_t{0640});
  WriteFile(folder / "old", "x");
  chmod((folder / "old").c_str(), 0606);
  ASSERT_TRUE(WriteWhole(folder / "old", "y"));
  umask(before);
  EXPECT_EQ(ModeOf(folder / "old"), mode_t{0606});
}

TEST(AtomicFile, FollowsASymbolicLinkAndLeavesItInPlace) {
  TempFolder folder;
  std::filesystem::create_directory(folder / "deep");
  for (const bool dangling : {true, false}) {
    if (!dangling) WriteFile(folder / "deep/target", "old");
    std::filesystem::remove(folder / "link");
    std::filesystem::create_symlink("deep/target", folder / "link");
    const auto written = WriteWhole(folder / "link", "new");
    ASSERT_TRUE(written) << MessageOf(written);
    EXPECT_TRUE(std::filesystem::is_symlink(folder / "link"));
    EXPECT_EQ(ReadFile(folder / "deep/target"), "new");
  }
  std::filesystem::create_symlink("loop", folder / "loop");
  const auto looped = WriteWhole(folder / "loop", "x");
  ASSERT_FALSE(looped);
  EXPECT_EQ(looped.error().code, ErrorCode::kIo);
}

TEST(AtomicFile, TakesTheLongestNameThatTheSystemTakes) {
  TempFolder folder;
  const std::string name(255, 'n');
  const auto written = WriteWhole(folder / name, "x");
  ASSERT_TRUE(written) << MessageOf(written);
  EXPECT_EQ(folder.List(), Names{name});
}

TEST(AtomicFile, WritesDevicesAndPipesStraightThrough) {
  EXPECT_TRUE(WriteWhole("/dev/null", "x"));
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const auto written = WriteWhole("/dev/fd/" + std::to_string(ends[1]), "through");
  EXPECT_TRUE(written) << MessageOf(written);
  char bytes[16];
  EXPECT_EQ(read(ends[0], bytes, sizeof bytes), 7);
  close(ends[0]);
  close(ends[1]);
}

TEST(AtomicFile, WritesANamedPipeThroughAndLeavesIt) {
  TempFolder folder;
  const std::string name = folder / "pipe";
  ASSERT_EQ(mkfifo(name.c_str(), 0600), 0);
  std::string read_back;
  std::thread reader([&] { read_back = ReadFile(name); });
  const auto written = WriteWhole(name, std::string(300'000, 'p'));
  reader.join();
  EXPECT_TRUE(written) << MessageOf(written);
  EXPECT_EQ(read_back.size(), 300'000u);
  EXPECT_EQ(folder.List(), Names{"pipe"});
}

TEST(AtomicFile, AClosedPipeIsAnErrorAndNotASignal) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  close(ends[0]);
  const auto written = WriteWhole("/dev/fd/" + std::to_string(ends[1]), "x");
  close(ends[1]);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_NE(written.error().message.find("Broken pipe"), std::string::npos) << MessageOf(written);
}

TEST(AtomicFile, AFullDeviceIsAnErrorThatNamesTheOffset) {
  const auto written = WriteWhole("/dev/full", "12345");
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_EQ(written.error().message,
            "/dev/full: byte 0: cannot write 5 bytes: No space left on device");
}

TEST(AtomicFile, PassingTheFileSizeLimitLeavesNothing) {
  TempFolder folder;
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{1 << 20, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const auto written = WriteWhole(folder / "a", std::string(3 << 20, 'x'));
  setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_NE(written.error().message.find("byte 1048576: "), std::string::npos)
      << MessageOf(written);
  EXPECT_NE(written.error().message.find("File too large"), std::string::npos)
      << MessageOf(written);
  EXPECT_EQ(folder.List(), Names{});
}

TEST(AtomicFile, AFullDiskLeavesNothing) {
  TempFolder folder;
  std::filesystem::create_directory(folder / "disk");
  if (mount("tmpfs", (folder / "disk").c_str(), "tmpfs", 0, "size=256k") != 0) {
    GTEST_SKIP() << "mounting a small disk is not permitted here";
  }
  const auto whole = WriteWhole(folder / "disk/a", "old");
  const auto written = WriteWhole(folder / "disk/a", std::string(1 << 20, 'x'));
  const auto small = WriteWhole(folder / "disk/b", std::string(300 << 10, 'x'));
  Names names;
  for (const auto& e : std::filesystem::directory_iterator(folder / "disk")) {
    names.push_back(e.path().filename().string());
  }
  const std::string kept = ReadFile(folder / "disk/a");
  umount((folder / "disk").c_str());
  EXPECT_TRUE(whole) << MessageOf(whole);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_NE(written.error().message.find("No space left"), std::string::npos) << MessageOf(written);
  EXPECT_FALSE(small) << "an error in Finish's own flush";
  EXPECT_EQ(names, Names{"a"});
  EXPECT_EQ(kept, "old");
}

TEST(AtomicFile, MissingFolderAndFolderInPlaceOfAFileAreClearErrors) {
  TempFolder folder;
  const auto missing = WriteWhole(folder / "no/such/a.ply", "x");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kIo);
  EXPECT_NE(missing.error().message.find(folder / "no/such'"), std::string::npos)
      << MessageOf(missing);
  EXPECT_NE(missing.error().message.find("No such file"), std::string::npos) << MessageOf(missing);
  for (const std::string& name : {folder.path(), folder.path() + "/", std::string()}) {
    const auto refused = WriteWhole(name, "x");
    ASSERT_FALSE(refused) << name;
    EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  }
  EXPECT_EQ(folder.List(), Names{});
}

TEST(AtomicFile, AFolderWithoutWritePermissionIsAClearError) {
  TempFolder folder;
  const bool root = geteuid() == 0;
  chmod(folder.path().c_str(), 0555);
  if (root && seteuid(65534) != 0) GTEST_SKIP() << "root, and cannot become anybody else";
  const auto refused = WriteWhole(folder / "a", "x");
  ASSERT_EQ(root ? seteuid(0) : 0, 0);
  chmod(folder.path().c_str(), 0755);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  EXPECT_NE(refused.error().message.find("Permission denied"), std::string::npos)
      << MessageOf(refused);
}

TEST(AtomicFile, AfterAnErrorEveryCallRepeatsIt) {
  auto file = AtomicFile::Open("/dev/full");
  ASSERT_TRUE(file) << MessageOf(file);
  const auto first = (*file)->Write(std::string(2 << 20, 'x'));
  ASSERT_FALSE(first);
  const auto second = (*file)->Write("y");
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().message, first.error().message);
  const auto last = (*file)->Finish();
  ASSERT_FALSE(last);
  EXPECT_EQ(last.error().message, first.error().message);
}

TEST(AtomicFile, TheNextWriterRemovesWhatAKilledProcessLeft) {
  TempFolder folder;
  std::unique_ptr<AtomicFile> unfinished;
  Child child([&] {
    auto file = AtomicFile::Open(folder / "model.drc");
    if (!file || !(*file)->Write(std::string(2 << 20, 'x'))) _exit(1);
    unfinished = std::move(*file);
  });
  ASSERT_EQ(folder.List().size(), 1u);
  ASSERT_TRUE(WriteWhole(folder / "other.ply", "x"));
  EXPECT_EQ(folder.List().size(), 2u) << "the process lives, so its file must stay";

  child.Kill();
  ASSERT_EQ(folder.List().size(), 2u);
  EXPECT_FALSE(std::filesystem::exists(folder / "model.drc"));
  ASSERT_TRUE(WriteWhole(folder / "third.ply", "x"));
  EXPECT_EQ(folder.List(), (Names{"other.ply", "third.ply"}));
}

TEST(AtomicFile, RemovesNothingButItsOwnKindOfLeftovers) {
  TempFolder folder;
  const Names strangers = {".a.strata-0123456789abcde.part",   // 15 digits.
                           ".a.strata-0123456789abcdeF.part",  // Upper case.
                           ".a.strata-0123456789abcdef.parts", ".strata-0123456789abcdef.part",
                           "a.strata-0123456789abcdef.part"};
  for (const std::string& name : strangers) WriteFile(folder / name, "mine");
  WriteFile(folder / "target", "mine");
  std::filesystem::create_symlink("target", folder / ".l.strata-0123456789abcdef.part");
  std::filesystem::create_directory(folder / ".d.strata-0123456789abcdef.part");
  ASSERT_EQ(mkfifo((folder / ".f.strata-0123456789abcdef.part").c_str(), 0600), 0);
  WriteFile(folder / ".x.strata-0123456789abcdef.part", "left over");
  const std::size_t before = folder.List().size();
  ASSERT_TRUE(WriteWhole(folder / "out", "x"));
  EXPECT_EQ(folder.List().size(), before) << "one goes, 'out' comes";
  EXPECT_FALSE(std::filesystem::exists(folder / ".x.strata-0123456789abcdef.part"));
  EXPECT_EQ(ReadFile(folder / "target"), "mine");
}

TEST(AtomicFile, ManyWritersInOneFolderNeverRemoveEachOthersFiles) {
  TempFolder folder;
  const auto work = [&](int who) {
    for (int i = 0; i < 150; ++i) {
      const std::string name = folder / ("w" + std::to_string(who));
      const auto written = WriteWhole(name, std::to_string(i));
      if (!written || ReadFile(name) != std::to_string(i)) return false;
    }
    return true;
  };
  pid_t children[2];
  for (int c = 0; c < 2; ++c) {
    children[c] = fork();
    if (children[c] == 0) _exit(work(c) ? 0 : 1);
  }
  bool good[2];
  std::thread a([&] { good[0] = work(2); }), b([&] { good[1] = work(3); });
  a.join();
  b.join();
  EXPECT_TRUE(good[0] && good[1]);
  for (const pid_t child : children) {
    int status = -1;
    waitpid(child, &status, 0);
    EXPECT_EQ(status, 0);
  }
  EXPECT_EQ(folder.List(), (Names{"w0", "w1", "w2", "w3"}));
}

TEST(RemoveUnfinishedOutputs, RemovesTheUnfinishedAndKeepsTheFinished) {
  TempFolder folder;
  auto done = AtomicFile::Open(folder / "done");
  ASSERT_TRUE(done);
  ASSERT_TRUE((*done)->Finish());
  auto open = AtomicFile::Open(folder / "open");
  ASSERT_TRUE(open);
  ASSERT_TRUE((*open)->Write("x"));
  RemoveUnfinishedOutputs();
  EXPECT_EQ(folder.List(), Names{"done"});
  const auto late = (*open)->Finish();
  ASSERT_FALSE(late) << "there is nothing left that could be given the name";
  EXPECT_EQ(late.error().code, ErrorCode::kIo);
  EXPECT_EQ(folder.List(), Names{"done"});
}

}  // namespace
}  // namespace strata::io
