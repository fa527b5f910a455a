#include "io/text_scanner.h"

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/failing_source.h"

namespace strata::io {
namespace {

using Lines = std::vector<std::string>;

Lines LinesOf(const std::string& text, std::size_t dribble = 0, std::size_t limit = 1000) {
  auto source = MemorySource(text);
  if (dribble > 0) source = test::Dribble(std::move(source), dribble);
  TextScanner scanner(*source, limit);
  Lines lines;
  while (scanner.Next()) {
    lines.emplace_back(scanner.line());
    EXPECT_EQ(scanner.line_number(), lines.size());
  }
  EXPECT_FALSE(scanner.failed());
  return lines;
}

TEST(TextScanner, EndsLinesWithLfOrCrlf) {
  for (const std::size_t dribble : {0, 1, 2, 3}) {
    EXPECT_EQ(LinesOf("", dribble), (Lines{}));
    EXPECT_EQ(LinesOf("\n", dribble), (Lines{""}));
    EXPECT_EQ(LinesOf("a", dribble), (Lines{"a"}));
    EXPECT_EQ(LinesOf("a\nb\n\nc", dribble), (Lines{"a", "b", "", "c"}));
    EXPECT_EQ(LinesOf("a\r\nb\r\n", dribble), (Lines{"a", "b"}));
    EXPECT_EQ(LinesOf("a\nb\rc\n", dribble), (Lines{"a", "b\rc"}));
  }
}

TEST(TextScanner, EndsLinesWithALoneCrIfTheFirstOneDoes) {
  for (const std::size_t dribble : {0, 1, 2, 3}) {
    EXPECT_EQ(LinesOf("a\rb\r\rc", dribble), (Lines{"a", "b", "", "c"}));
    EXPECT_EQ(LinesOf("a\rb\nc\r\nd\r", dribble), (Lines{"a", "b", "c", "d"}));
    EXPECT_EQ(LinesOf("\r", dribble), (Lines{""}));
  }
}

TEST(TextScanner, EndsLinesAsTheFirstOneDoesWhereverItBegins) {
  for (const auto& [text, expected] :
       {std::pair("a\nb\rc\rd\n", "b\rc\rd"), std::pair("a\rb\nc\n", "b")}) {
    const auto source = MemorySource(text);
    TextScanner scanner(*source, 1000);
    ASSERT_TRUE(scanner.Seek(2, 2));
    ASSERT_TRUE(scanner.Next());
    EXPECT_EQ(scanner.line(), expected);
    EXPECT_EQ(scanner.line_number(), 2u);
  }
}

TEST(TextScanner, DropsAByteOrderMark) {
  EXPECT_EQ(LinesOf("\xEF\xBB\xBF"
                    "a\nb"),
            (Lines{"a", "b"}));
  EXPECT_EQ(LinesOf("\xEF\xBB\xBF"
                    "a\nb",
                    1),
            (Lines{"a", "b"}));
  EXPECT_EQ(LinesOf("\xEF\xBB"), (Lines{"\xEF\xBB"}));
}

TEST(TextScanner, KnowsWhetherTheLastLineWasEnded) {
  auto source = MemorySource("a\nb");
  TextScanner scanner(*source, 10);
  ASSERT_TRUE(scanner.Next());
  EXPECT_TRUE(scanner.terminated());
  ASSERT_TRUE(scanner.Next());
  EXPECT_FALSE(scanner.terminated());
}

TEST(TextScanner, AllowsLinesUpToTheLimit) {
  const std::string ten(10, 'x');
  EXPECT_EQ(LinesOf(ten + "\r\n" + ten + "\n" + ten, 0, 10), (Lines{ten, ten, ten}));
  for (const std::string& text : {"a\n" + ten + "x", "a\n" + ten + "x\n", "a\r" + ten + "x\r"}) {
    auto source = MemorySource(text, "long.obj");
    TextScanner scanner(*source, 10);
    EXPECT_TRUE(scanner.Next());
    EXPECT_FALSE(scanner.Next());
    ASSERT_TRUE(scanner.failed());
    EXPECT_EQ(scanner.failure().value().code, ErrorCode::kCorruptInput);
    EXPECT_EQ(scanner.failure().value().message,
              "long.obj: line 2: found a line of 11 bytes or more, expected at most 10");
  }
  auto source = MemorySource(std::string(5000000, 'x'));
  TextScanner scanner(*source, 10);
  EXPECT_FALSE(scanner.Next());
  EXPECT_TRUE(scanner.failed());
}

TEST(TextScanner, ReadsLongTextsInSmallPieces) {
  Lines expected;
  std::string text;
  for (int i = 0; i < 3000; ++i) {
    expected.push_back(std::string(static_cast<std::size_t>(i) % 900, 'a'));
    text += expected.back() + "\n";
  }
  EXPECT_EQ(LinesOf(text, 700), expected);
  EXPECT_EQ(LinesOf(text), expected);
}

TEST(TextScanner, JoinsContinuedLines) {
  for (const std::string end : {"\n", "\r\n", "\r"}) {
    auto source = MemorySource("a \\" + end + "b\\ " + end + "c" + end + "d # \\" + end + "e");
    TextScanner scanner(*source, 100);
    const auto next = [&] { return scanner.Next() && scanner.JoinContinuations(); };
    ASSERT_TRUE(next());
    EXPECT_EQ(scanner.line(), "a  b c");
    EXPECT_EQ(scanner.line_number(), 1u);
    EXPECT_EQ(scanner.line_offset(), 0u);
    ASSERT_TRUE(next());
    EXPECT_EQ(scanner.line(), "d # \\");
    EXPECT_EQ(scanner.line_number(), 4u);
    ASSERT_TRUE(next());
    EXPECT_EQ(scanner.line(), "e");
    EXPECT_FALSE(next());
    EXPECT_FALSE(scanner.failed());
  }
}

TEST(TextScanner, RefusesJoinedLinesThatAreTooLongOrEndTheText) {
  for (const std::string text : {"abc\\\ndef\\\nghi\\\njkl\n", "abc\\\n", "abc\\"}) {
    auto source = MemorySource(text);
    TextScanner scanner(*source, 10);
    ASSERT_TRUE(scanner.Next());
    EXPECT_FALSE(scanner.JoinContinuations());
    EXPECT_TRUE(scanner.failed());
    EXPECT_NE(scanner.failure().value().message.find("line 1: found"), std::string::npos);
  }
}

TEST(TextScanner, GoesBackToALine) {
  auto source = MemorySource("one\ntwo\nthree\n");
  TextScanner scanner(*source, 100);
  ASSERT_TRUE(scanner.Next());
  ASSERT_TRUE(scanner.Next());
  const auto offset = scanner.line_offset(), number = scanner.line_number();
  while (scanner.Next()) {
  }
  ASSERT_TRUE(scanner.Seek(offset, number).has_value());
  ASSERT_TRUE(scanner.Next());
  EXPECT_EQ(scanner.line(), "two");
  EXPECT_EQ(scanner.line_number(), 2u);
  EXPECT_EQ(scanner.next_offset(), 8u);
}

TEST(TextScanner, PassesOnReadErrors) {
  const std::string text = "one\ntwo\nthree\n";
  for (std::uint64_t at = 0; at < text.size(); ++at) {
    test::FailingSource source(MemorySource(text), at, 2);
    TextScanner scanner(source, 100);
    while (scanner.Next()) {
    }
    ASSERT_TRUE(scanner.failed());
    EXPECT_EQ(scanner.failure().value().code, ErrorCode::kIo);
  }
}

}  // namespace
}  // namespace strata::io
