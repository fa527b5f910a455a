#include "server/batch/manifest.h"

#include <gtest/gtest.h>

#include <string>

#include "server/batch/names.h"
#include "server/batch/owner.h"
#include "tests/support/temp_folder.h"

namespace strata::server {
namespace {

using test::ReadFile;
using test::TempFolder;
using test::WriteFile;

ManifestLine Sampled(const std::string& path) {
  ManifestLine line;
  line.path = path;
  line.sampled = true;
  line.input_sha256 = std::string(64, 'a');
  line.input_bytes = 1234;
  line.stamp = "12.000000001 7";
  line.version = "0.1.0";
  line.options = R"({"resolution":16,"lambda":5,"seed":"18446744073709551615"})";
  line.output = path + ".drc";
  line.output_bytes = 99;
  line.output_sha256 = std::string(64, 'b');
  line.samples = 10;
  line.cells = 12;
  line.triangles = 20;
  line.edge = 0.1;
  line.area = 1.5;
  line.skipped = {{"zero_area", 3}};
  line.surface_hash = "0123";
  line.measured = {0.25, 1000, 42, 2, "2026-01-02T03:04:05.678Z"};
  return line;
}

ManifestLine Failed(const std::string& path, const std::string& message) {
  ManifestLine line = Sampled(path);
  line.sampled = false;
  line.error_type = "corrupt-input";
  line.error_message = message;
  return line;
}

TEST(ManifestLine, ReadsBackAsItWasWritten) {
  const ManifestLine line = Sampled("a/b.ply");
  const std::string text = ToJsonLine(line);
  const auto read = FromJsonLine(text);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(ToJsonLine(*read), text);
  EXPECT_EQ(read->options, line.options) << "options are compared as texts";
  EXPECT_EQ(read->skipped, line.skipped);
  EXPECT_EQ(read->measured.attempts, 2);
  const auto failed = FromJsonLine(ToJsonLine(Failed("x", "m")));
  ASSERT_TRUE(failed);
  EXPECT_EQ(failed->error_type, "corrupt-input");
  EXPECT_EQ(failed->output, "") << "a model that failed has no output";
}

TEST(ManifestLine, KeepsNamesThatAreNoText) {
  for (const std::string name : {"line\nbreak.ply", "caf\xe9.ply", "-o", "<script>", "a\"b\\c"}) {
    const std::string text = ToJsonLine(Failed(name, name));
    EXPECT_EQ(text.find('\n'), text.npos) << Printable(name);
    const auto read = FromJsonLine(text);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->path, name) << Printable(name);
  }
}

TEST(Names, ArePrintedOnOneLine) {
  EXPECT_EQ(Printable("a\nb\x1b[31m\xe9"), "a\\nb\\x1b[31m\\xe9");
  EXPECT_EQ(Printable("caf\xc3\xa9"), "caf\xc3\xa9");
  EXPECT_EQ(Printable("\xc2\x85"), "\\xc2\\x85") << "a control character beyond ASCII";
}

class ManifestFile : public testing::Test {
 protected:
  std::unique_ptr<Manifest> Open() {
    auto manifest = Manifest::Open(path);
    if (!manifest) ADD_FAILURE() << manifest.error().message;
    return manifest ? *std::move(manifest) : nullptr;
  }
  TempFolder folder;
  const std::string path = folder / "manifest.jsonl";
};

TEST_F(ManifestFile, TheLastLineOfAPathCounts) {
  {
    const auto manifest = Open();
    ASSERT_TRUE(manifest->Append(Failed("a", "first")));
    ASSERT_TRUE(manifest->Append(Sampled("b")));
    ASSERT_TRUE(manifest->Append(Failed("a", "second")));
  }
  const auto manifest = Open();
  const auto line = manifest->Find("a");
  ASSERT_TRUE(line && *line);
  EXPECT_EQ((*line)->error_message, "second");
  const auto none = manifest->Find("c");
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->has_value());
}

TEST_F(ManifestFile, EveryPrefixHoldsTheWholeLinesOfIt) {
  {
    const auto manifest = Open();
    for (const char* const name : {"a", "b", "c"}) ASSERT_TRUE(manifest->Append(Sampled(name)));
  }
  const std::string whole = ReadFile(path);
  for (std::size_t size = 0; size <= whole.size(); ++size) {
    const std::string left = whole.substr(0, size);
    const auto lines = static_cast<std::size_t>(std::count(left.begin(), left.end(), '\n'));
    WriteFile(path, left);
    const auto reader = ManifestReader::Open(path);
    ASSERT_TRUE(reader) << "of " << size << " bytes: " << reader.error().message;
    ASSERT_EQ(reader->size(), lines) << "of " << size << " bytes";
    if (size % 97 != 0) continue;  // What is appended is synced to disk.
    ASSERT_TRUE(Open()->Append(Sampled("d")));
    const auto again = ManifestReader::Open(path);
    ASSERT_TRUE(again) << "after " << size << " bytes: " << again.error().message;
    ASSERT_EQ(again->size(), lines + 1) << "after " << size << " bytes";
  }
}

TEST_F(ManifestFile, ALineInTheMiddleThatIsNoneIsNamed) {
  WriteFile(path, ToJsonLine(Sampled("a")) + "\n{\n" + ToJsonLine(Sampled("b")) + "\n");
  const auto opened = Manifest::Open(path);
  ASSERT_FALSE(opened);
  EXPECT_EQ(opened.error().code, ErrorCode::kCorruptInput);
  EXPECT_NE(opened.error().message.find(path + ", line 2"), std::string::npos)
      << opened.error().message;
}

TEST_F(ManifestFile, IsRewrittenInOrderWithOneLineAPath) {
  const auto manifest = Open();
  for (const char* const name : {"c", "a", "b", "a"}) {
    ASSERT_TRUE(manifest->Append(Sampled(name)));
  }
  manifest->Forget("b");
  ASSERT_TRUE(manifest->Rewrite());
  EXPECT_EQ(ReadFile(path), ToJsonLine(Sampled("a")) + '\n' + ToJsonLine(Sampled("c")) + '\n');
  ASSERT_TRUE(manifest->Append(Sampled("d"))) << "it goes on in the new file";
  EXPECT_EQ(Manifest::Open(path)->get()->Paths().size(), 3u);
}

TEST(Owner, KeepsAllOthersOutButTheSharesBesideIt) {
  const TempFolder folder;
  {
    const auto first = Owner::Take(folder.path(), "");
    ASSERT_TRUE(first) << first.error().message;
    for (const char* const share : {"", "1-of-2"}) {
      const auto second = Owner::Take(folder.path(), share);
      ASSERT_FALSE(second) << share;
      EXPECT_EQ(second.error().code, ErrorCode::kConflict);
      EXPECT_NE(second.error().message.find("process " + std::to_string(getpid())),
                std::string::npos)
          << second.error().message;
    }
  }
  auto one = Owner::Take(folder.path(), "0-of-2");
  ASSERT_TRUE(one);
  EXPECT_FALSE(one->former_was_killed()) << "this share is new";
  EXPECT_TRUE(Owner::Take(folder.path(), "1-of-2"));
  EXPECT_FALSE(Owner::Take(folder.path(), "0-of-2"));
  EXPECT_FALSE(Owner::Take(folder.path(), ""));
  one->Finish();
}

TEST(Owner, LearnsThatAFormerOneWasKilled) {
  const TempFolder folder;
  { ASSERT_FALSE(Owner::Take(folder.path(), "")->former_was_killed()); }
  auto second = Owner::Take(folder.path(), "");
  EXPECT_TRUE(second->former_was_killed());
  second->Finish();
  second = Fail(ErrorCode::kInternal, "");
  EXPECT_FALSE(Owner::Take(folder.path(), "")->former_was_killed());
}

}  // namespace
}  // namespace strata::server
