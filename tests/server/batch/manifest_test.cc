#include "server/batch/manifest.h"

#include <gtest/gtest.h>

#include <functional>
#include <initializer_list>
#include <string>
#include <utility>

#include "server/batch/former_lines.h"
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
  line.companions = {{"b.bin", 5, "11.000000002 8"}, {"c/\xff.png", 0, ""}};
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
  line.left_out = {"texture: wood.png: not found"};
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
  ASSERT_EQ(read->companions.size(), 2u);
  EXPECT_EQ(read->companions[1].path, "c/\xff.png");
  EXPECT_EQ(read->skipped, line.skipped);
  EXPECT_EQ(read->left_out, line.left_out);
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

TEST(ManifestLine, NamesNoOtherFileThanItsModels) {
  const auto refused = [](const std::function<void(ManifestLine&)>& change) {
    ManifestLine line = Sampled("a/b.ply");
    change(line);
    const auto read = FromJsonLine(ToJsonLine(line));
    if (read) return std::string();
    EXPECT_EQ(read.error().code, ErrorCode::kCorruptInput);
    return read.error().message;
  };
  EXPECT_EQ(refused([](auto&) {}), "");
  EXPECT_EQ(refused([](auto& line) { line.picture = ".strata/pictures/00ff.png"; }), "");
  for (const char* const output :
       {"", "a/b.ply", "a/b.ply.", "a/b.ply.txt", "a/b.ply.x.drc", "a/b.ply./c.drc", "../b.ply.drc",
        "/a/b.ply.drc", "a/b.ply/../c.drc", "a/bXply.drc"}) {
    EXPECT_NE(refused([output](auto& line) { line.output = output; }), "") << output;
  }
  for (const char* const picture : {"../x.png", ".strata/pictures/../../x.png", "x.png"}) {
    EXPECT_NE(refused([picture](auto& line) { line.picture = picture; }), "") << picture;
  }
  for (const char* const path : {"", "..", "../a", "/a", "a//b"}) {
    EXPECT_NE(refused([path](auto& line) {
                line.path = path;
                line.output = std::string(path) + ".drc";
              }),
              "")
        << path;
  }
}

TEST(ManifestLine, HoldsNumbersWhereNumbersBelong) {
  const std::string whole = ToJsonLine(Sampled("a"));
  for (const auto& [from, to] :
       std::initializer_list<std::pair<const char*, const char*>>{{R"("samples":10)", "-10"},
                                                                  {R"("samples":10)", "1e300"},
                                                                  {R"("samples":10)", "10.5"},
                                                                  {R"("samples":10)", "\"10\""},
                                                                  {R"("area":1.5)", "null"},
                                                                  {R"("zero_area":3)", "-3"},
                                                                  {R"("worker":42)", "-1"}}) {
    std::string text = whole;
    const std::string_view found = from;
    const std::size_t at = text.find(found);
    ASSERT_NE(at, text.npos) << from;
    const std::size_t colon = found.find(':') + 1;
    text.replace(at + colon, found.size() - colon, to);
    const auto read = FromJsonLine(text);
    ASSERT_FALSE(read) << text;
    EXPECT_EQ(read.error().code, ErrorCode::kCorruptInput);
  }
}

TEST(ManifestLine, EndsInAnErrorHoweverDeepItsBracketsGo) {
  const std::string open(1'000'000, '[');
  for (const std::string& text :
       {open, "{\"options\":" + open + std::string(open.size(), ']') + "}"}) {
    EXPECT_FALSE(FromJsonLine(text));
  }
  EXPECT_TRUE(FromJsonLine(ToJsonLine(Sampled("[[[[[[[[\"[[[[\\[[[[[[[[[[[[[[[[[[[[[[[[[[[[["))))
      << "those of a name count for nothing";
}

TEST(ManifestLine, OfAModelThatIsGoneSaysNoMore) {
  ManifestLine line;
  line.path = "a/b.ply";
  line.gone = true;
  line.measured.finished = InstantNow();
  const auto read = FromJsonLine(ToJsonLine(line));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_TRUE(read->gone);
  EXPECT_FALSE(read->sampled);
  EXPECT_EQ(read->measured.finished, line.measured.finished);
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

TEST(FormerLines, OfAllSharesAreFoundTheOwnFirst) {
  const TempFolder folder;
  ManifestLine theirs = Sampled("a"), later = Sampled("a");
  theirs.output_sha256 = std::string(64, 'c');
  theirs.measured.finished = "2026-01-01T00:00:00.000Z";
  later.output_sha256 = std::string(64, 'd');
  later.measured.finished = "2027-01-01T00:00:00.000Z";
  WriteFile(folder / "manifest-0-of-2.jsonl", ToJsonLine(theirs) + '\n');
  WriteFile(folder / "manifest-1-of-2.jsonl", ToJsonLine(Sampled("b")) + '\n');
  auto own = Manifest::Open(folder / "manifest.jsonl");
  ASSERT_TRUE((*own)->Append(Sampled("a")));
  const auto former = FormerLines::Open(folder.path(), "manifest.jsonl", **own);
  ASSERT_TRUE(former) << former.error().message;
  EXPECT_EQ(former->Paths(), (std::vector<std::string>{"a", "b"}));
  EXPECT_TRUE(former->IsElsewhere("a"));
  EXPECT_FALSE(former->IsElsewhere("c"));
  const auto lines = former->Of("a");
  ASSERT_TRUE(lines) << lines.error().message;
  ASSERT_EQ(lines->size(), 2u);
  EXPECT_EQ(lines->front().output_sha256, std::string(64, 'b'));
  EXPECT_FALSE(IsOverruled(lines->front(), *lines)) << "the other one is older";
  EXPECT_TRUE(IsOverruled(lines->front(), {lines->front(), later}));
  ManifestLine gone;
  gone.path = "a";
  gone.gone = true;
  ASSERT_TRUE((*own)->Append(gone));
  EXPECT_EQ(former->Of("a")->size(), 1u) << "what the other share has stays known";
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
