// strata merge --region: any number of processes, in any order, leave the folder of one.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "core/stopwatch.h"
#include "tests/support/process.h"

namespace strata::test {
namespace {

using testing::HasSubstr;
using Files = std::map<std::string, std::string>;
using Options = std::vector<std::string>;

class RegionMerge : public testing::Test {
 protected:
  RegionMerge() {
    // A wavy sheet of 45,000 triangles.
    constexpr int kSide = 150;
    std::string text;
    for (int i = 0; i <= kSide; ++i) {
      for (int j = 0; j <= kSide; ++j) {
        text += "v " + std::to_string(i) + ' ' + std::to_string(j) + ' ' +
                std::to_string((i * j) % 7) + '\n';
      }
    }
    const auto at = [](int i, int j) { return std::to_string(i * (kSide + 1) + j + 1); };
    for (int i = 0; i < kSide; ++i) {
      for (int j = 0; j < kSide; ++j) {
        text += "f " + at(i, j) + ' ' + at(i + 1, j) + ' ' + at(i + 1, j + 1) + '\n';
        text += "f " + at(i, j) + ' ' + at(i + 1, j + 1) + ' ' + at(i, j + 1) + '\n';
      }
    }
    WriteFile(In("sheet.obj"), text);
  }

  std::string In(const std::string& name) const { return folder / name; }

  Options Scan(const Options& options = {}, int count = 2) const {
    Options parts;
    for (int i = 0; i < count; ++i) {
      parts.push_back(In("part-" + std::to_string(parts_made_++) + ".run"));
      Options arguments = {"scan",
                           In("sheet.obj"),
                           "--quiet",
                           "-o",
                           parts.back(),
                           "--share",
                           std::to_string(i) + '/' + std::to_string(count),
                           "--resolution",
                           "120"};
      arguments.insert(arguments.end(), options.begin(), options.end());
      const Outcome outcome = test::Run(STRATA_BINARY, arguments);
      EXPECT_EQ(outcome.status, 0) << outcome.err;
    }
    return parts;
  }
  Options Arguments(const Options& parts, const std::string& output, const Options& options,
                    const std::string& region) const {
    Options arguments = {"merge", "-o", In(output), "--tile-samples", "700"};
    arguments.insert(arguments.end(), parts.begin(), parts.end());
    arguments.insert(arguments.end(), options.begin(), options.end());
    if (!region.empty()) arguments.insert(arguments.end(), {"--region", region});
    return arguments;
  }
  Outcome Merge(const Options& parts, const std::string& output, const Options& options = {},
                const std::string& region = "") const {
    return test::Run(STRATA_BINARY, Arguments(parts, output, options, region));
  }

  // Every file in a folder, by its path within.
  Files Contents(const std::string& name) const {
    Files files;
    if (!std::filesystem::is_directory(In(name))) return files;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(In(name))) {
      if (!entry.is_regular_file()) continue;
      const std::string path = entry.path().string();
      files[path.substr(In(name).size() + 1)] = ReadText(path);
    }
    return files;
  }
  // What one merge leaves.
  Files Whole(const Options& parts, const Options& options) const {
    const Outcome outcome = Merge(parts, "whole.drc", options);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    const Files files = Contents("whole.drc");
    EXPECT_GT(files.size(), 5u);
    return files;
  }
  void ExpectFinished(const std::string& output, const Files& expected) const {
    EXPECT_TRUE(Contents(output) == expected);
    for (const std::string& name : folder.Names()) {
      EXPECT_EQ(name.find(".regions"), std::string::npos) << name;
      EXPECT_EQ(name.find(".strata-"), std::string::npos) << name;
    }
  }
  static std::string Name(std::uint32_t region, std::uint32_t count) {
    return std::to_string(region) + '/' + std::to_string(count);
  }

  ScratchFolder folder;
  mutable int parts_made_ = 0;
};

TEST_F(RegionMerge, InAnyOrderAndTwiceLeavesTheBytesOfOneMerge) {
  std::mt19937 random(81);
  for (const Options& scan : {Options{}, Options{"--integrator", "subdivide"}}) {
    const Options parts = Scan(scan);
    for (const char* m : {"0", "0.5", "0.9"}) {
      const Options options = {"--min-distance", m};
      const Files expected = Whole(parts, options);
      for (const std::uint32_t count : {1u, 2u, 7u, 40u}) {
        if (count == 40 && (std::string(m) != "0.5" || !scan.empty())) continue;
        std::filesystem::remove_all(In("out.drc"));
        std::vector<std::uint32_t> order;
        for (std::uint32_t r = 0; r < count; ++r) order.push_back(r);
        if (count < 40) order.push_back(random() % count);  // Twice.
        std::shuffle(order.begin(), order.end(), random);
        for (std::size_t i = 0; i < order.size(); ++i) {
          const Outcome outcome = Merge(parts, "out.drc", options, Name(order[i], count));
          ASSERT_EQ(outcome.status, 0) << outcome.err << "seed 81, m " << m;
          if (i + 2 < order.size()) {
            EXPECT_FALSE(std::filesystem::exists(In("out.drc")));
          }
        }
        SCOPED_TRACE("seed 81, m " + std::string(m) + ", " + std::to_string(count) + " regions");
        ExpectFinished("out.drc", expected);
        EXPECT_THAT(Merge(parts, "out.drc", options, Name(0, count)).err, HasSubstr("all done"));
        ExpectFinished("out.drc", expected);
      }
    }
  }
}

TEST_F(RegionMerge, AtTheSameTimeLeavesTheBytesOfOneMerge) {
  const Options parts = Scan();
  const Options options = {"--attributes", "normal,area", "--threads", "1", "--quiet"};
  const Files expected = Whole(parts, options);
  for (int round = 0; round < 5; ++round) {
    std::filesystem::remove_all(In("out.drc"));
    std::vector<std::unique_ptr<Child>> children;
    for (std::uint32_t r = 0; r < 8; ++r) {  // Every region by two processes.
      children.push_back(std::make_unique<Child>(
          STRATA_BINARY, Arguments(parts, "out.drc", options, Name(r % 4, 4))));
    }
    for (auto& child : children) EXPECT_EQ(child->Wait(), 0) << child->Err();
    ExpectFinished("out.drc", expected);
  }
}

TEST_F(RegionMerge, KilledAtRandomMomentsAndRunAgainLeavesTheBytesOfOneMerge) {
  std::mt19937 random(82);
  const Options parts = Scan();
  const Options options = {"--threads", "1", "--quiet"};
  const Files expected = Whole(parts, options);
  const Stopwatch watch;
  ASSERT_EQ(Merge(parts, "out.drc", options, "0/1").status, 0);
  double once = watch.seconds();
  int killed = 0;
  for (int round = 0; round < 5; ++round) {
    std::filesystem::remove_all(In("out.drc"));
    for (std::uint32_t r = 0; r < 3; ++r) {
      for (int attempt = 0; attempt < 3; ++attempt) {
        const Stopwatch lived;
        Child child(STRATA_BINARY, Arguments(parts, "out.drc", options, Name(r, 3)));
        // The machine may have been busy when it was measured.
        if (child.EndsWithin(once * (random() % 1000) / 2000))
          once = std::min(once, lived.seconds());
        child.Signal(SIGKILL);
        killed += child.Wait() == 1000 + SIGKILL ? 1 : 0;
      }
      const Outcome outcome = Merge(parts, "out.drc", options, Name(r, 3));
      ASSERT_EQ(outcome.status, 0) << outcome.err << "seed 82, round " << round;
    }
    SCOPED_TRACE("seed 82, round " + std::to_string(round));
    ExpectFinished("out.drc", expected);
  }
  std::printf("seed 82: %d of 45 processes killed before their end\n", killed);
  EXPECT_GT(killed, 4);
}

// The names that a process leaves which is killed between its last tile and its end.
TEST_F(RegionMerge, GoesOnWhereAProcessWasKilledWhilePublishing) {
  enum State { kAllFragments, kClaimed, kManifest, kPublished };
  const Options parts = Scan(), other = {"--min-distance", "0.7"};
  const Files expected = Whole(parts, {});
  const std::string work = In("out.drc.regions"), claimed = work + "/claimed-0123456789abcdef";
  for (const bool over_old : {false, true}) {
    for (const State state : {kAllFragments, kClaimed, kManifest, kPublished}) {
      SCOPED_TRACE(std::to_string(state) + (over_old ? " over an old output" : ""));
      std::filesystem::remove_all(In("out.drc"));
      if (over_old) {
        ASSERT_EQ(Merge(parts, "out.drc", other).status, 0);
      }
      // Two unfinished outputs together are one whose regions are all there.
      ASSERT_EQ(Merge(parts, "out.drc", {}, "0/2").status, 0);
      ASSERT_EQ(Merge(parts, "b.drc", {}, "1/2").status, 0);
      const auto merge =
          std::filesystem::copy_options::recursive | std::filesystem::copy_options::skip_existing;
      std::filesystem::copy(In("b.drc.regions"), work, merge);
      std::filesystem::remove_all(In("b.drc.regions"));
      if (state != kAllFragments) std::filesystem::rename(work + "/folder", claimed);
      if (state >= kManifest) WriteFile(claimed + "/tileset.json", expected.at("tileset.json"));
      if (state == kPublished) {  // The two have exchanged their names.
        if (over_old) std::filesystem::rename(In("out.drc"), In("old"));
        std::filesystem::rename(claimed, In("out.drc"));
        if (over_old) std::filesystem::rename(In("old"), claimed);
      }
      const Outcome outcome = Merge(parts, "out.drc", {}, "1/2");
      ASSERT_EQ(outcome.status, 0) << outcome.err;
      EXPECT_THAT(outcome.err, HasSubstr("was there already"));
      ExpectFinished("out.drc", expected);
    }
  }
}

TEST_F(RegionMerge, AnotherMergeInTheSamePlaceIsRefusedByWhatDiffers) {
  const Options parts = Scan();
  ASSERT_EQ(Merge(parts, "out.drc", {}, "0/3").status, 0);
  const auto refusal = [&](const Options& from, const Options& options, const std::string& region) {
    const Outcome outcome = Merge(from, "out.drc", options, region);
    EXPECT_EQ(outcome.status, 2) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("out.drc.regions: another merge is under way there"));
    return outcome.err;
  };
  EXPECT_THAT(refusal(parts, {}, "1/4"), HasSubstr("regions is 3 there, here 4"));
  EXPECT_THAT(refusal(parts, {"--min-distance", "0.4"}, "1/3"),
              HasSubstr("samples/min_distance is 0.5 there, here 0.4"));
  EXPECT_THAT(refusal(parts, {"--attributes", "none"}, "1/3"), HasSubstr("attributes"));
  EXPECT_THAT(refusal(parts, {"--position-error", "0.1"}, "1/3"), HasSubstr("position_error"));
  EXPECT_THAT(refusal(Scan({"--seed", "5"}), {}, "1/3"),
              HasSubstr("samples/seed is 0 there, here 5"));
  // Other shares of the same mesh are the same merge.
  ASSERT_EQ(Merge(Scan({}, 3), "out.drc", {}, "1/3").status, 0);
  ASSERT_EQ(Merge(parts, "out.drc", {}, "2/3").status, 0);
  ExpectFinished("out.drc", Whole(parts, {}));
}

TEST_F(RegionMerge, ReplacesOnlyAFileOrTilesAndNotBeforeTheEnd) {
  const Options parts = Scan();
  const Files expected = Whole(parts, {});
  std::filesystem::create_directory(In("mine"));
  WriteFile(In("mine/letter"), "dear");
  const Outcome refused = Merge(parts, "mine", {"--format", "drc"}, "0/2");
  EXPECT_NE(refused.status, 0);
  EXPECT_EQ(ReadText(In("mine/letter")), "dear");
  EXPECT_FALSE(std::filesystem::exists(In("mine.regions")));
  ASSERT_EQ(Merge(parts, "tiles.drc", {"--min-distance", "0"}).status, 0);
  WriteFile(In("file.drc"), "a file");
  const Files old = Contents("tiles.drc");
  for (const char* output : {"tiles.drc", "file.drc"}) {
    ASSERT_EQ(Merge(parts, output, {}, "1/2").status, 0);
    if (std::string(output) == "file.drc") {
      EXPECT_EQ(ReadText(In(output)), "a file");
    } else {
      EXPECT_TRUE(Contents(output) == old);
    }
    const Outcome last = Merge(parts, output, {}, "0/2");
    ASSERT_EQ(last.status, 0) << last.err;
    ExpectFinished(output, expected);
  }
}

TEST_F(RegionMerge, WorksWithinLittleMemory) {
  const Options parts = Scan();
  const Options options = {"--memory", "64M"};
  const Files expected = Whole(parts, {});
  for (const std::uint32_t r : {2u, 0u, 1u}) {
    const Outcome outcome = Merge(parts, "out.drc", options, Name(r, 3));
    ASSERT_EQ(outcome.status, 0) << outcome.err;
  }
  ExpectFinished("out.drc", expected);
}

TEST_F(RegionMerge, IsForFoldersOfTilesAlone) {
  const auto refusal = [&](const std::string& output, const Options& options,
                           const std::string& region) {
    const Outcome outcome = Merge({In("none.run")}, output, options, region);
    EXPECT_EQ(outcome.status, 2) << outcome.err;
    return outcome.err;
  };
  for (const char* output : {"out.ply", "out.xyz", "out.npz", "out.run"}) {
    EXPECT_THAT(refusal(output, {}, "0/2"), HasSubstr("--region needs a drc OUTPUT"));
  }
  EXPECT_THAT(refusal("out.drc", {"--picture", In("a.png")}, "0/2"), HasSubstr("--picture"));
  for (const char* region : {"2/2", "0/0", "-1/2", "1", "a/b", "0/70000", ""}) {
    Options arguments = Arguments({In("none.run")}, "out.drc", {}, "");
    arguments.insert(arguments.end(), {"--region", region});
    EXPECT_EQ(test::Run(STRATA_BINARY, arguments).status, 2) << region;
  }
}

TEST_F(RegionMerge, ADamagedPartIsRefusedByName) {
  const Options parts = Scan({}, 1);
  std::string bytes = ReadText(parts[0]);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 4);
  WriteFile(parts[0], bytes);
  int refused = 0;
  for (std::uint32_t r = 0; r < 2; ++r) {
    const Outcome outcome = Merge(parts, "out.drc", {}, Name(r, 2));
    if (outcome.status == 0) continue;  // The damage lies in the other region.
    EXPECT_EQ(outcome.status, 4) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr("part-0.run"));
    ++refused;
  }
  EXPECT_GE(refused, 1);
  EXPECT_FALSE(std::filesystem::exists(In("out.drc")));
}

}  // namespace
}  // namespace strata::test
