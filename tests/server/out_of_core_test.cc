// Jobs that do not fit their memory, as a user runs them: what is full, killed or smaller shows in
// an exit code or not at all, never in the bytes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <random>
#include <string>
#include <vector>

#include "tests/support/fixed_disk.h"
#include "tests/support/process.h"
#include "tests/support/shapes.h"

namespace strata::test {
namespace {

using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr std::uint64_t kMega = 1 << 20;

struct Output {
  const char* name;
  std::vector<std::string> options = {};
  friend void PrintTo(const Output& output, std::ostream* out) {
    *out << output.name << (output.options.empty() ? "" : " in tiles");
  }
};
const Output kPly{"out.ply"}, kNpz{"out.npz"}, kXyz{"out.xyz"}, kDraco{"out.drc"},
    kTiles{"out.drc", {"--tile-samples", "250000"}};

std::string NameOf(const testing::TestParamInfo<Output>& info) {
  const std::string suffix = std::string(info.param.name).substr(4);
  return info.param.options.empty() ? suffix : "tiles";
}

/// The bytes of a file, or of all the files of a folder, by name.
std::map<std::string, std::string> BytesUnder(const std::string& path) {
  namespace fs = std::filesystem;
  std::map<std::string, std::string> bytes;
  if (fs::is_regular_file(path)) bytes[""] = ReadText(path);
  if (!fs::is_directory(path)) return bytes;
  for (const auto& entry : fs::recursive_directory_iterator(path)) {
    if (!entry.is_regular_file()) continue;
    bytes[fs::relative(entry.path(), path).string()] = ReadText(entry.path().string());
  }
  return bytes;
}

/// A mesh of twelve triangles over a million cells: in 64 MiB its reservoirs go to disk.
class OutOfCore : public testing::TestWithParam<Output> {
 protected:
  OutOfCore() {
    WriteFile(input, CubeObj());
    changed_ = std::filesystem::last_write_time(input);
  }
  ~OutOfCore() override {
    EXPECT_EQ(ReadText(input), CubeObj()) << "the input was touched";
    EXPECT_EQ(std::filesystem::last_write_time(input), changed_) << "the input was touched";
  }

  std::vector<std::string> Arguments(const std::string& output, const std::string& scratch_folder,
                                     const Output& kind, const std::string& memory) const {
    std::vector<std::string> all = {"sample",       input,  "-o",        output,
                                    "--memory",     memory, "--scratch", scratch_folder,
                                    "--resolution", "400",  "--threads", "2"};
    all.insert(all.end(), kind.options.begin(), kind.options.end());
    return all;
  }
  Outcome Sample(const std::string& output, const std::string& scratch_folder, const Output& kind,
                 const std::string& memory = "64M") const {
    return test::Run(STRATA_BINARY, Arguments(output, scratch_folder, kind, memory));
  }
  /// What has to come out.
  std::map<std::string, std::string> Expected(const Output& kind) const {
    const ScratchFolder folder;
    const Outcome outcome = Sample(folder / kind.name, scratch.path(), kind);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return BytesUnder(folder / kind.name);
  }

  ScratchFolder inputs, scratch;
  std::string input = inputs / "cube.obj";

 private:
  std::filesystem::file_time_type changed_;
};

// --- Full disks ----------------------------------------------------------------------------------

using FullDisk = OutOfCore;

TEST_P(FullDisk, OfScratchSpaceIsNamedAndNothingIsLeft) {
  const auto expected = Expected(GetParam());
  int refused = 0;
  for (const std::uint64_t size : {kMega / 4, 4 * kMega, 16 * kMega, 32 * kMega, 256 * kMega}) {
    SCOPED_TRACE(size);
    const FixedDisk disk(size);
    if (!disk.failure().empty()) GTEST_SKIP() << disk.failure();
    const ScratchFolder folder;
    const Outcome outcome = Sample(folder / GetParam().name, disk.path(), GetParam());
    EXPECT_THAT(disk.Names(), IsEmpty());
    if (outcome.status == 0) {
      EXPECT_TRUE(BytesUnder(folder / GetParam().name) == expected);
      continue;
    }
    ++refused;
    EXPECT_EQ(outcome.status, 8) << outcome.err;
    EXPECT_EQ(outcome.err, "strata: scratch space " + disk.path() + ": No space left on device\n");
    EXPECT_THAT(folder.Names(), IsEmpty());
  }
  EXPECT_GE(refused, 2) << "the job hardly needs scratch space";
  EXPECT_LT(refused, 5) << "the job needs more scratch space than was thought";
}

TEST_P(FullDisk, OfTheOutputIsNamedAndWhatStoodThereStays) {
  const auto expected = Expected(GetParam());
  int refused = 0;
  for (const std::uint64_t size : {kMega / 4, 2 * kMega, 256 * kMega}) {
    SCOPED_TRACE(size);
    const FixedDisk disk(size);
    if (!disk.failure().empty()) GTEST_SKIP() << disk.failure();
    const std::string output = disk / GetParam().name;
    WriteFile(output, "older");
    const Outcome outcome = Sample(output, scratch.path(), GetParam());
    EXPECT_THAT(scratch.Names(), IsEmpty());
    EXPECT_THAT(disk.Names(), ElementsAre(GetParam().name));
    if (outcome.status == 0) {
      EXPECT_TRUE(BytesUnder(output) == expected);
      continue;
    }
    ++refused;
    EXPECT_EQ(outcome.status, 8) << outcome.err;
    EXPECT_THAT(outcome.err, HasSubstr(output));
    EXPECT_THAT(outcome.err, HasSubstr("No space left on device"));
    EXPECT_EQ(ReadText(output), "older");
  }
  EXPECT_EQ(refused, 2);
}

INSTANTIATE_TEST_SUITE_P(Formats, FullDisk, testing::Values(kPly, kNpz, kTiles), NameOf);

// --- Killed --------------------------------------------------------------------------------------

class Killed : public OutOfCore {
 protected:
  static constexpr int kKills = 10;  // Of each kind of output.

  struct Times {
    double seconds, write_seconds;
  };
  /// Of a run that is left in peace; leaves nothing in `folder`.
  Times Measure(const ScratchFolder& folder, const Output& kind) const {
    const std::string output = folder / kind.name, summary = folder / "summary.json";
    std::vector<std::string> arguments = Arguments(output, scratch.path(), kind, "64M");
    arguments.insert(arguments.end(), {"--summary", summary});
    const Outcome outcome = test::Run(STRATA_BINARY, arguments);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    const json told = json::parse(ReadText(summary));
    std::filesystem::remove_all(output);
    std::filesystem::remove(summary);
    return {told["seconds"], told["stages"]["write"]["seconds"]};
  }
};

TEST_P(Killed, AtRandomMomentsLeavesNoOutputAndTheNextRunCleansUp) {
  const auto expected = Expected(GetParam());
  const ScratchFolder folder;
  const std::string output = folder / GetParam().name;
  Times whole = Measure(folder, GetParam());
  const unsigned seed = std::random_device{}();
  std::printf("seed %u\n", seed);
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 engine(seed);
  int kills = 0, left_something = 0;
  for (int tries = 0; kills < kKills && tries < 5 * kKills; ++tries) {
    Child strata(STRATA_BINARY, Arguments(output, scratch.path(), GetParam(), "64M"));
    // Every other time while the output is being written, which is a small part of it all.
    const double from = tries % 2 == 0 ? 0 : whole.seconds - whole.write_seconds;
    const double after = from + (whole.seconds - from) * engine() / 0x1p32;
    SCOPED_TRACE("killed after " + std::to_string(after) + " s");
    const bool ended = strata.EndsWithin(after);
    strata.Signal(SIGKILL);
    const int status = strata.Wait();
    // The name is given in the end, to all of the output: it may have it, but never a part.
    if (std::filesystem::exists(output)) {
      EXPECT_TRUE(BytesUnder(output) == expected);
      std::filesystem::remove_all(output);
    }
    if (status == 0) {  // Too late; it may be that the machine was busy when it was measured.
      whole = Measure(folder, GetParam());
      continue;
    }
    EXPECT_FALSE(ended) << strata.Err();
    EXPECT_EQ(status, 1000 + SIGKILL) << strata.Err();
    ++kills;
    left_something += !folder.Names().empty() || !scratch.Names().empty();
    const Outcome next = Sample(output, scratch.path(), GetParam());
    EXPECT_EQ(next.status, 0) << next.err;
    EXPECT_TRUE(BytesUnder(output) == expected);
    EXPECT_THAT(folder.Names(), ElementsAre(GetParam().name));
    EXPECT_THAT(scratch.Names(), IsEmpty());
    std::filesystem::remove_all(output);
  }
  EXPECT_EQ(kills, kKills);
  std::printf("%d kills, %d of which left temporary files for the next run\n", kills,
              left_something);
}

INSTANTIATE_TEST_SUITE_P(Formats, Killed, testing::Values(kPly, kTiles), NameOf);

// --- Budgets -------------------------------------------------------------------------------------

using Budgets = OutOfCore;

TEST_P(Budgets, ChangeNoByteAndBoundThePeak) {
  const ScratchFolder folder;
  const std::string output = folder / GetParam().name, summary = folder / "summary.json";
  std::map<std::string, std::string> first;
  for (const std::uint64_t budget : {64, 128, 512}) {
    SCOPED_TRACE(budget);
    std::vector<std::string> arguments =
        Arguments(output, scratch.path(), GetParam(), std::to_string(budget) + "M");
    arguments.insert(arguments.end(), {"--summary", summary});
    const Outcome outcome = test::Run(STRATA_BINARY, arguments);
    ASSERT_EQ(outcome.status, 0) << outcome.err;
    const auto bytes = BytesUnder(output);
    EXPECT_FALSE(bytes.empty());
    if (first.empty()) first = bytes;
    EXPECT_TRUE(bytes == first);
    const auto peak = json::parse(ReadText(summary))["peak_memory_bytes"].get<std::uint64_t>();
    if (STRATA_SANITIZED == 0) {
      EXPECT_LE(peak, (budget + 64) * kMega);
    }
    std::filesystem::remove_all(output);
  }
}

INSTANTIATE_TEST_SUITE_P(Formats, Budgets, testing::Values(kPly, kXyz, kNpz, kDraco, kTiles),
                         NameOf);

}  // namespace
}  // namespace strata::test
