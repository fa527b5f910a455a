// strata scan and strata merge: shares in any order give the bytes of one process.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "tests/support/mesh_text.h"
#include "tests/support/process.h"

namespace strata::test {
namespace {

using testing::HasSubstr;

// A plane of 2 n^2 triangles: several shares' blocks of them.
std::string PlaneObj(int n) {
  std::string text;
  for (int i = 0; i <= n; ++i) {
    for (int j = 0; j <= n; ++j) {
      text += "v " + std::to_string(i) + ' ' + std::to_string(j) + ' ' +
              std::to_string((i * j) % 7) + '\n';
    }
  }
  const auto at = [&](int i, int j) { return std::to_string(i * (n + 1) + j + 1); };
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      text += "f " + at(i, j) + ' ' + at(i + 1, j) + ' ' + at(i + 1, j + 1) + '\n';
      text += "f " + at(i, j) + ' ' + at(i + 1, j + 1) + ' ' + at(i, j + 1) + '\n';
    }
  }
  return text;
}

class Shares : public testing::Test {
 protected:
  Shares() { WriteFile(In("plane.obj"), PlaneObj(450)); }

  std::string In(const std::string& name) const { return folder / name; }
  Outcome Strata(const std::vector<std::string>& arguments) const {
    return test::Run(STRATA_BINARY, arguments, "");
  }
  std::string Scan(int index, int count, const std::vector<std::string>& options = {},
                   const std::string& mesh = "plane.obj") const {
    const std::string name = In("part-" + std::to_string(index) + "-of-" + std::to_string(count) +
                                (options.empty() ? "" : options.back()) + ".run");
    std::vector<std::string> arguments = {
        "scan", In(mesh), "--share", std::to_string(index) + '/' + std::to_string(count),
        "-o",   name,     "--quiet"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const Outcome outcome = Strata(arguments);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return name;
  }
  Outcome Merge(std::vector<std::string> parts, const std::string& output,
                const std::vector<std::string>& options = {}) const {
    parts.insert(parts.begin(), "merge");
    parts.insert(parts.end(), {"-o", In(output), "--quiet"});
    parts.insert(parts.end(), options.begin(), options.end());
    return Strata(parts);
  }
  std::string Sampled(const std::string& output, const std::vector<std::string>& options) const {
    std::vector<std::string> arguments = {"sample", In("plane.obj"), "-o", In(output), "--quiet"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const Outcome outcome = Strata(arguments);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return ReadText(In(output));
  }

  ScratchFolder folder;
};

TEST_F(Shares, InAnyOrderGiveTheBytesOfOneProcess) {
  std::mt19937 random(51);
  for (const std::vector<std::string>& lattice : {std::vector<std::string>{"--resolution", "300"},
                                                  {"--height", "8"},
                                                  {"--voxel-size", "2"}}) {
    std::vector<std::string> options = lattice;
    options.insert(options.end(), {"--attributes", "normal,triangle,barycentric,cell,area"});
    const std::string whole = Sampled("whole.ply", options);
    for (const int count : {1, 2, 5}) {
      std::vector<std::string> parts;
      for (int i = 0; i < count; ++i) parts.push_back(Scan(i, count, options));
      parts.push_back(parts.front());  // Given twice.
      std::shuffle(parts.begin(), parts.end(), random);
      const Outcome merged = Merge(parts, "merged.ply", {options.end() - 2, options.end()});
      ASSERT_EQ(merged.status, 0) << merged.err;
      EXPECT_TRUE(ReadText(In("merged.ply")) == whole) << "seed 51, " << lattice[0] << ' ' << count;
    }
  }
}

TEST_F(Shares, MergeInAnyTree) {
  const std::vector<std::string> options = {"--resolution", "200"};
  const std::string whole = Sampled("whole.drc", options);
  std::vector<std::string> parts;
  for (int i = 0; i < 4; ++i) parts.push_back(Scan(i, 4, options));
  ASSERT_EQ(Merge({parts[3], parts[1]}, "a.run").status, 0);
  ASSERT_EQ(Merge({parts[0], In("a.run"), parts[1]}, "b.run").status, 0);
  const Outcome merged = Merge({parts[2], In("b.run"), In("a.run")}, "merged.drc");
  ASSERT_EQ(merged.status, 0) << merged.err;
  EXPECT_TRUE(ReadText(In("merged.drc")) == whole);
}

TEST_F(Shares, MergeInLittleMemory) {
  const std::vector<std::string> options = {"--voxel-size", "0.6"};
  const std::string whole = Sampled("whole.ply", options);
  std::vector<std::string> parts;
  for (int i = 0; i < 3; ++i)
    parts.push_back(Scan(i, 3, {"--memory", "64M", "--voxel-size", "0.6"}));
  const Outcome merged = Merge(parts, "merged.ply", {"--memory", "64M"});
  ASSERT_EQ(merged.status, 0) << merged.err;
  EXPECT_TRUE(ReadText(In("merged.ply")) == whole);
}

TEST_F(Shares, MergesMorePartsThanTheSoftLimitOfOpenFiles) {
  const std::string part = Scan(0, 1, {"--resolution", "30"});
  std::string command =
      "ulimit -S -n 32; exec " STRATA_BINARY " merge --quiet -o '" + In("merged.ply") + "'";
  for (int i = 0; i < 60; ++i) command += " '" + part + "'";
  const Outcome outcome = test::Run("/bin/sh", {"-c", command}, "");
  EXPECT_EQ(outcome.status, 0) << outcome.err;
  EXPECT_TRUE(ReadText(In("merged.ply")) == Sampled("whole.ply", {"--resolution", "30"}));
}

TEST_F(Shares, AGivenLatticeSavesFindingIt) {
  const std::string whole = Sampled("whole.ply", {"--resolution", "90", "--summary", In("s.json")});
  const std::string summary = ReadText(In("s.json"));
  // "origin": [x, y, z], "edge": e, as the JSON writes them: shortest text that reads back the
  // same.
  std::string numbers;
  for (std::size_t i = summary.find("\"origin\""); i < summary.find("\"cells\""); ++i) {
    const char c = summary[i];
    if (std::isdigit(static_cast<unsigned char>(c)) || c == '-' || c == '.' || c == ',')
      numbers += c;
  }
  numbers.erase(numbers.find_last_not_of(',') + 1);
  std::vector<std::string> parts;
  for (int i = 0; i < 2; ++i) {
    parts.push_back(Scan(i, 2, {"--lattice=" + numbers, "--resolution", "90"}));
  }
  const Outcome merged = Merge(parts, "merged.ply");
  ASSERT_EQ(merged.status, 0) << merged.err << numbers;
  EXPECT_TRUE(ReadText(In("merged.ply")) == whole);
}

TEST_F(Shares, WhatDoesNotBelongTogetherIsRefusedByName) {
  WriteFile(In("other.obj"), PlaneObj(10));
  const std::string first = Scan(0, 2, {"--resolution", "50"});
  const auto refusal = [&](const std::vector<std::string>& parts) {
    const Outcome outcome = Merge(parts, "out.ply");
    EXPECT_EQ(outcome.status, 2) << outcome.err;
    EXPECT_TRUE(ReadText(In("out.ply")).empty());
    return outcome.err;
  };
  EXPECT_THAT(refusal({first}), HasSubstr("1 of 2 shares are missing: 1/2"));
  EXPECT_THAT(refusal({first, Scan(1, 2, {"--resolution", "51"})}), HasSubstr("lattice asked for"));
  EXPECT_THAT(refusal({first, Scan(1, 3, {"--resolution", "50"})}), HasSubstr("number of shares"));
  EXPECT_THAT(refusal({first, Scan(1, 2, {"--resolution", "50", "--seed", "9"})}),
              HasSubstr("the seed"));
  EXPECT_THAT(refusal({first, Scan(1, 2, {"--resolution", "50", "--lambda", "4"})}),
              HasSubstr("lambda"));
  EXPECT_THAT(refusal({first, Scan(1, 2, {"--resolution", "50"}, "other.obj")}),
              HasSubstr("differ in the mesh"));
  const std::string one = Scan(1, 3, {"--resolution", "50"}),
                    two = Scan(2, 3, {"--resolution", "50"}),
                    zero = Scan(0, 3, {"--resolution", "50"});
  ASSERT_EQ(Merge({zero, one}, "zero-one.run").status, 0);
  ASSERT_EQ(Merge({one, two}, "one-two.run").status, 0);
  EXPECT_THAT(refusal({In("zero-one.run"), In("one-two.run")}),
              HasSubstr("no longer be told apart"));
}

TEST_F(Shares, EveryDamagedPartialIsRefusedByName) {
  const std::string name = Scan(0, 1, {"--resolution", "20"});
  const std::string bytes = ReadText(name);
  std::mt19937 random(52);
  for (int round = 0; round < 60; ++round) {
    std::string damaged = bytes;
    const std::size_t at = round < 20 ? static_cast<std::size_t>(round) : random() % bytes.size();
    if (round % 2 == 0)
      damaged.resize(at);
    else
      damaged[at] = static_cast<char>(damaged[at] ^ (1 << random() % 8));
    WriteFile(In("damaged.run"), damaged);
    const Outcome outcome = Merge({In("damaged.run")}, "out.ply");
    if (outcome.status == 0) {  // A reserved byte.
      EXPECT_LT(at, 24u);
      continue;
    }
    EXPECT_TRUE(outcome.status == 4 || outcome.status == 5 || outcome.status == 2)
        << "seed 52, byte " << at << ": " << outcome.status << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("damaged.run"));
  }
}

}  // namespace
}  // namespace strata::test
