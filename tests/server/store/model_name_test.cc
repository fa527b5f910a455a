#include "server/store/model_name.h"

#include <gtest/gtest.h>

#include <random>
#include <string>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

TEST(ModelName, TakesOrdinaryNamesInEveryScript) {
  for (const std::string& name :
       {std::string("a"), std::string("bunny.ply"), std::string("cars/mini v2/body.stl"),
        std::string("a..b"), std::string("Käfer"), std::string("模型/龙.obj"), std::string("🐰"),
        std::string("a.b.c"), std::string("%2e%2e"), std::string("C:"), std::string("~root"),
        std::string("$HOME"), std::string("a b"), std::string(255, 'n'),
        std::string(127, 'n') + "/" + std::string(127, 'n')}) {
    EXPECT_OK(CheckModelName(name)) << name;
  }
}

TEST(ModelName, RefusesWhatLeavesTheFolderOrHidesInIt) {
  using namespace std::string_literals;
  const std::vector<std::string> refused = {""s,
                                            "/"s,
                                            "/etc/passwd"s,
                                            "//"s,
                                            "a//b"s,
                                            "a/"s,
                                            "/a"s,
                                            "."s,
                                            ".."s,
                                            "../a"s,
                                            "a/.."s,
                                            "a/../b"s,
                                            "a/./b"s,
                                            "./a"s,
                                            ".hidden"s,
                                            "a/.hidden"s,
                                            "..."s,
                                            "..\\a"s,
                                            "a\\b"s,
                                            "\\\\host"s,
                                            "a\0b"s,
                                            "\0"s,
                                            "a\nb"s,
                                            "a\rb"s,
                                            "a\tb"s,
                                            "\x1b[31m"s,
                                            "a\x7f"s,
                                            "\xc2\x80"s,      // C1.
                                            "\xe2\x80\xa8"s,  // Line separator.
                                            "\xe2\x80\xa9"s,  // Paragraph separator.
                                            "\xff"s,
                                            "a\xc3"s,               // No UTF-8; cut short.
                                            "\xc0\xae\xc0\xae/a"s,  // Overlong dots.
                                            "\xc0\xaf"s,            // An overlong slash.
                                            "\xed\xa0\x80"s,        // A surrogate.
                                            "\xf4\x90\x80\x80"s,    // Beyond Unicode.
                                            std::string(256, 'n'),
                                            std::string(127, 'n') + "/" + std::string(128, 'n')};
  for (const std::string& name : refused) {
    const auto checked = CheckModelName(name);
    EXPECT_FALSE(checked) << name;
    if (checked) continue;
    EXPECT_EQ(checked.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(checked.error().message.find("byte "), std::string::npos) << Why(checked);
  }
}

TEST(ModelName, WhateverPassesStaysBelowItsFolder) {
  constexpr std::uint64_t kSeed = 20'240'401;
  SCOPED_TRACE("seed " + std::to_string(kSeed));
  std::mt19937_64 random(kSeed);
  using namespace std::string_literals;
  const std::string alphabet = "./\\ab\0\n\xc3\xa4\xff%~"s;
  std::size_t passed = 0;
  for (int i = 0; i < 200'000; ++i) {
    std::string name(random() % 12, 0);
    for (char& c : name) c = alphabet[random() % alphabet.size()];
    if (!CheckModelName(name)) continue;
    ++passed;
    const std::filesystem::path path = std::filesystem::path("/root") / name;
    ASSERT_TRUE(path.lexically_normal().string().starts_with("/root/")) << name;
    ASSERT_EQ(path.lexically_normal(), path) << name;
    ASSERT_EQ(name.find('\0'), std::string::npos);
    ASSERT_EQ(name.find('\n'), std::string::npos);
  }
  EXPECT_GT(passed, 100u) << "the test would say nothing";
}

}  // namespace
}  // namespace strata::server
