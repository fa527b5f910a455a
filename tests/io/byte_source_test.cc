#include "io/byte_source.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <thread>

#include "tests/support/compress.h"
#include "tests/support/failing_source.h"

namespace strata::io {
namespace {

using test::FailingSource;
using test::Gzip;
using test::Zstd;

std::string Pattern(std::size_t n) {
  std::string text(n, '\0');
  std::uint32_t state = 1;
  for (char& c : text)
    c = static_cast<char>("0123456789abcdef"[(state = state * 1664525u + 1) >> 28]);
  return text;
}

Result<std::string> ReadAll(ByteSource& source, std::size_t chunk = 1000) {
  std::string all, part(chunk, '\0');
  for (;;) {
    auto n = source.Read(part);
    if (!n) return Forward(n);
    if (*n == 0) return all;
    all.append(part, 0, *n);
  }
}

class TempFolder {
 public:
  TempFolder() {
    std::string path = (std::filesystem::temp_directory_path() / "strata-test-XXXXXX").string();
    path_ = ::mkdtemp(path.data());
  }
  ~TempFolder() { std::filesystem::remove_all(path_); }
  std::string Write(const std::string& name, const std::string& bytes) const {
    const std::string path = Path(name);
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  std::string Path(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

TEST(ByteSource, ReadsAFileAndKnowsItsSize) {
  TempFolder folder;
  const std::string text = Pattern(300'000);
  auto source = OpenByteSource(folder.Write("a", text));
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ((*source)->size(), text.size());
  EXPECT_EQ((*source)->compression(), "none");
  EXPECT_EQ(ReadAll(**source), text);
  ASSERT_TRUE((*source)->Seek(299'990));
  EXPECT_EQ(ReadAll(**source), text.substr(299'990));
}

TEST(ByteSource, UnpacksGzipAndZstdByTheirMagic) {
  TempFolder folder;
  const std::string text = Pattern(700'000);
  for (const auto& [packed, name] :
       {std::pair(Gzip(text), "gzip"), std::pair(Zstd(text), "zstd")}) {
    auto source = OpenByteSource(folder.Write("packed", packed));
    ASSERT_TRUE(source) << source.error().message;
    EXPECT_EQ((*source)->compression(), name);
    EXPECT_EQ((*source)->size(), std::nullopt);
    EXPECT_EQ((*source)->stored_size(), packed.size());
    EXPECT_EQ(ReadAll(**source, 77'777), text) << name;
    EXPECT_EQ((*source)->stored_position(), packed.size());
  }
}

TEST(ByteSource, ReadsSeveralMembersAndFramesAsOneStream) {
  const std::string a = Pattern(5000), b = "tail";
  const std::string skippable("\x50\x2a\x4d\x18\x03\0\0\0abc", 11);
  for (const std::string& packed :
       {Gzip(a) + Gzip("") + Gzip(b), Gzip(a) + Gzip(b) + std::string(5000, '\0'),
        Zstd(a) + Zstd("") + Zstd(b), skippable + Zstd(a) + skippable + Zstd(b)}) {
    for (const std::size_t most : {std::size_t{1}, std::size_t{7}, SIZE_MAX}) {
      EXPECT_EQ(ReadAll(*MemorySource(packed), std::min<std::size_t>(most, 4096)), a + b);
    }
  }
}

TEST(ByteSource, SeeksInUnpackedStreams) {
  const std::string text = Pattern(50'000);
  for (const std::string& packed : {Gzip(text), Zstd(text)}) {
    auto source = MemorySource(packed);
    for (const std::size_t at : {0, 40'000, 100, 100, 49'999, 50'000, 1}) {
      ASSERT_TRUE(source->Seek(at));
      EXPECT_EQ(ReadAll(*source), text.substr(at)) << at;
    }
  }
}

TEST(ByteSource, RefusesEveryProperPrefixOfPackedData) {
  const std::string text = Pattern(400);
  for (const std::string& packed : {Gzip(text), Zstd(text)}) {
    for (std::size_t n = 4; n < packed.size(); ++n) {
      auto all = ReadAll(*MemorySource(packed.substr(0, n)));
      ASSERT_FALSE(all) << n;
      EXPECT_EQ(all.error().code, ErrorCode::kCorruptInput);
      EXPECT_NE(all.error().message.find("byte " + std::to_string(n)), std::string::npos)
          << all.error().message;
    }
  }
}

TEST(ByteSource, RefusesDamagedPackedData) {
  const std::string text = Pattern(4000);
  std::string damaged = Gzip(text);
  damaged[damaged.size() / 2] ^= 0x10;
  for (const std::string& packed :
       {damaged, Gzip(text) + "junk", Gzip(text) + std::string(3, '\0') + Gzip(text),
        Zstd(text) + "junk"}) {
    auto all = ReadAll(*MemorySource(packed));
    ASSERT_FALSE(all);
    EXPECT_EQ(all.error().code, ErrorCode::kCorruptInput) << all.error().message;
  }
}

TEST(ByteSource, RefusesAZstdWindowThatWouldHaveToBeHeldInMemory) {
  // Magic, a descriptor with neither content size nor single segment, and a window of 2^30.
  const std::string huge("\x28\xb5\x2f\xfd\x00\xa0\x01\x00\x00", 9);
  auto all = ReadAll(*MemorySource(huge));
  ASSERT_FALSE(all);
  EXPECT_EQ(all.error().code, ErrorCode::kUnsupported) << all.error().message;
}

TEST(ByteSource, SaysWhatIsWrongWithAPath) {
  TempFolder folder;
  auto missing = OpenByteSource(folder.Path("missing.ply"));
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  EXPECT_NE(missing.error().message.find("missing.ply"), std::string::npos);
  auto directory = OpenByteSource(folder.Path(""));
  ASSERT_FALSE(directory);
  EXPECT_NE(directory.error().message.find("directory"), std::string::npos);
}

TEST(ByteSource, GivesAnErrorWhenTheFileShrinksWhileItIsRead) {
  TempFolder folder;
  const std::string path = folder.Write("a", Pattern(100'000));
  auto source = OpenByteSource(path);
  ASSERT_TRUE(source);
  std::filesystem::resize_file(path, 50'000);
  auto all = ReadAll(**source);
  ASSERT_FALSE(all);
  EXPECT_EQ(all.error().code, ErrorCode::kIo);
  EXPECT_NE(all.error().message.find("byte 50000"), std::string::npos) << all.error().message;
}

TEST(ByteSource, DoesNotSeeWhatIsAppendedAfterOpening) {
  TempFolder folder;
  const std::string path = folder.Write("a", "abc");
  auto source = OpenByteSource(path);
  ASSERT_TRUE(source);
  std::ofstream(path, std::ios::app) << "def";
  EXPECT_EQ(ReadAll(**source), "abc");
}

TEST(ByteSource, RewindsAPipe) {
  TempFolder folder;
  const std::string path = folder.Path("fifo"), text = Pattern(300'000);
  ASSERT_EQ(::mkfifo(path.c_str(), 0600), 0);
  std::thread writer([&] { std::ofstream(path, std::ios::binary) << Gzip(text); });
  auto source = OpenByteSource(path);
  writer.join();
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ((*source)->compression(), "gzip");
  EXPECT_EQ(ReadAll(**source), text);
  ASSERT_TRUE((*source)->Seek(0));
  EXPECT_EQ(ReadAll(**source), text);
}

TEST(ByteSource, ReadsStandardInputFromAPipeAndFromWhereAFileStands) {
  const int saved = ::dup(STDIN_FILENO);
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  ASSERT_EQ(::write(ends[1], "piped", 5), 5);
  ::close(ends[1]);
  ::dup2(ends[0], STDIN_FILENO);
  auto piped = OpenByteSource("-");
  std::FILE* file = std::tmpfile();
  std::fputs("skipped,kept", file);
  std::fflush(file);
  ::lseek(::fileno(file), 8, SEEK_SET);
  ::dup2(::fileno(file), STDIN_FILENO);
  auto redirected = OpenByteSource("-");
  ::dup2(saved, STDIN_FILENO);
  ::close(saved), ::close(ends[0]), std::fclose(file);
  ASSERT_TRUE(piped && redirected);
  EXPECT_EQ(ReadAll(**piped), "piped");
  EXPECT_EQ(ReadAll(**redirected), "kept");
  EXPECT_EQ((*redirected)->size(), 4u);
}

TEST(InputBuffer, PeeksAcrossShortReads) {
  const std::string text = Pattern(10'000);
  for (const std::size_t most : {1, 3, 64, 100'000}) {
    auto source = test::Dribble(MemorySource(text), most);
    InputBuffer buffer(*source, 64);
    std::string seen;
    for (std::size_t want = 1; seen.size() < text.size(); want = want % 64 + 1) {
      EXPECT_EQ(buffer.offset(), seen.size());
      auto window = buffer.Peek(want);
      ASSERT_TRUE(window);
      ASSERT_GE(window->size(), std::min(want, text.size() - seen.size()));
      seen += window->substr(0, want);
      buffer.Consume(std::min(want, window->size()));
    }
    EXPECT_EQ(seen, text);
    EXPECT_EQ(buffer.Peek(1)->size(), 0u);
    ASSERT_TRUE(buffer.Seek(5));
    EXPECT_EQ(buffer.Peek(4)->substr(0, 4), text.substr(5, 4));
  }
}

TEST(InputBuffer, DeliversWhatCameBeforeAFailure) {
  FailingSource source(MemorySource(Pattern(100)), 10);
  InputBuffer buffer(source, 64);
  EXPECT_EQ(buffer.Peek(10)->size(), 10u);
  auto more = buffer.Peek(11);
  ASSERT_FALSE(more);
  EXPECT_EQ(more.error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace strata::io
