// Jobs that are killed, and go on with --resume, as a user runs them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/process.h"
#include "tests/support/soup.h"

namespace strata::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;
using testing::IsEmpty;

/// Looks every few milliseconds, for a minute at most.
bool Until(const std::function<bool()>& condition) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(1);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    poll(nullptr, 0, 5);
  }
  return true;
}

/// A sphere over half a million cells, which do not fit 64 MiB.
class Resume : public testing::Test {
 protected:
  Resume() {
    WriteFile(mesh_,
              SoupBytes(SphereSoup(300'000, Order::kCoherent, false), "binary_little_endian"));
  }

  std::vector<std::string> Arguments(std::vector<std::string> more = {}) const {
    std::vector<std::string> all = {
        "sample",        mesh_,       "-o", output_,        "--memory", "64M",       "--scratch",
        scratch_.path(), "--threads", "2",  "--resolution", "360",      "--summary", summary_};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  Outcome Sample(const std::vector<std::string>& more = {}) const {
    return test::Run(STRATA_BINARY, Arguments(more));
  }
  /// The samples of a job that nothing disturbs, in a scratch directory of its own.
  std::string Expected(const std::vector<std::string>& more = {}) const {
    const ScratchFolder folder, other;
    std::vector<std::string> arguments = Arguments(more);
    arguments[3] = folder / "expected.ply";
    arguments[7] = other.path();
    const Outcome outcome = test::Run(STRATA_BINARY, arguments);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return ReadText(arguments[3]);
  }
  std::uint64_t ResumedAt() const { return json::parse(ReadText(summary_))["resumed_at_triangle"]; }

  /// The job's folder once it has a checkpoint; empty before.
  std::string FolderWithCheckpoint() const {
    for (const std::string& name : scratch_.Names()) {
      if (fs::exists(scratch_ / (name + "/checkpoint"))) return scratch_ / name;
    }
    return {};
  }
  /// A job that has a checkpoint and is stopped before its end. One that was quicker leaves no
  /// output.
  std::unique_ptr<Child> StoppedAfterCheckpoint(const std::vector<std::string>& arguments) const {
    for (int tries = 0; tries < 20; ++tries) {
      auto strata = std::make_unique<Child>(STRATA_BINARY, arguments);
      EXPECT_TRUE(Until([&] { return !FolderWithCheckpoint().empty() || strata->EndsWithin(0); }))
          << strata->Err();
      strata->Signal(SIGSTOP);
      if (!strata->EndsWithin(0) && !FolderWithCheckpoint().empty()) return strata;
      strata->Signal(SIGCONT);
      EXPECT_EQ(strata->Wait(), 0) << strata->Err();
      fs::remove(output_);
      fs::remove(summary_);
    }
    throw std::runtime_error("each job was done before it could be stopped");
  }
  /// Kills a job that has a checkpoint; returns its folder.
  std::string KillAfterCheckpoint() const {
    const auto strata = StoppedAfterCheckpoint(Arguments());
    strata->Signal(SIGKILL);
    EXPECT_EQ(strata->Wait(), 1000 + SIGKILL);
    return FolderWithCheckpoint();
  }
  void ExpectDone(const Outcome& outcome, const std::string& expected) const {
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_TRUE(ReadText(output_) == expected);
    EXPECT_THAT(scratch_.Names(), IsEmpty());
  }

  ScratchFolder inputs_, scratch_, outputs_;
  std::string mesh_ = inputs_ / "sphere.ply", output_ = outputs_ / "out.ply",
              summary_ = outputs_ / "summary.json";
};

TEST_F(Resume, GoesOnAfterEachOfTwentyKillsWithTheSameBytes) {
  const std::string expected = Expected();
  ASSERT_EQ(Sample().status, 0);
  const double seconds = json::parse(ReadText(summary_))["seconds"];
  const unsigned seed = std::random_device{}();
  std::printf("seed %u\n", seed);
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 engine(seed);
  int kills = 0, resumed = 0, finished = 0;
  for (int tries = 0; kills < 20 && tries < 200; ++tries) {
    fs::remove(output_);
    Child strata(STRATA_BINARY, Arguments({"--resume"}));
    const auto end = std::chrono::steady_clock::now() +
                     std::chrono::duration<double>(1.2 * seconds * engine() / 0x1p32);
    bool ended = false;
    while (!ended && std::chrono::steady_clock::now() < end) {
      poll(nullptr, 0, 2);
      ended = fs::exists(output_);
    }
    strata.Signal(SIGKILL);
    const int status = strata.Wait();
    if (status == 1000 + SIGKILL) ++kills;
    if (fs::exists(output_)) {
      EXPECT_TRUE(ReadText(output_) == expected);
    }
    if (status != 0) continue;
    ++finished;
    resumed += ResumedAt() > 0;
  }
  EXPECT_EQ(kills, 20);
  ExpectDone(Sample({"--resume"}), expected);
  resumed += ResumedAt() > 0;
  std::printf("%d kills, %d jobs finished meanwhile, %d of all had gone on\n", kills, finished,
              resumed);
}

TEST_F(Resume, StartsWhereTheLastRunEnded) {
  const std::string expected = Expected();
  KillAfterCheckpoint();
  ExpectDone(Sample({"--resume"}), expected);
  EXPECT_GT(ResumedAt(), 0u);
  EXPECT_LE(ResumedAt(), 300'000u);
}

TEST_F(Resume, IsWhatAStartWithoutItCleansUp) {
  const std::string expected = Expected();
  ASSERT_FALSE(KillAfterCheckpoint().empty());
  ExpectDone(Sample(), expected);
  EXPECT_EQ(ResumedAt(), 0u);
}

TEST_F(Resume, DoesNotTakeOverAnotherJob) {
  KillAfterCheckpoint();
  for (const std::vector<std::string>& other : std::vector<std::vector<std::string>>{
           {"--seed", "1"}, {"--lambda", "4"}, {"--attributes", "barycentric"}}) {
    const std::string expected = Expected(other);
    std::vector<std::string> more = other;
    more.push_back("--resume");
    const Outcome outcome = Sample(more);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    EXPECT_EQ(ResumedAt(), 0u);
    EXPECT_TRUE(ReadText(output_) == expected);
    EXPECT_FALSE(FolderWithCheckpoint().empty()) << "what may still go on was removed";
  }
}

TEST_F(Resume, TakesWhatDecidesNoReservoirAsItNowIs) {
  KillAfterCheckpoint();
  const std::vector<std::string> other = {"--min-distance", "0.8", "--attributes", "area"};
  const std::string expected = Expected(other);
  std::vector<std::string> arguments = Arguments(other);
  arguments[5] = "80M";
  arguments[9] = "1";
  arguments.push_back("--resume");
  ExpectDone(test::Run(STRATA_BINARY, arguments), expected);
  EXPECT_GT(ResumedAt(), 0u);
}

TEST_F(Resume, StartsAnewWhenTheMeshHasChanged) {
  KillAfterCheckpoint();
  WriteFile(mesh_, SoupBytes(SphereSoup(250'000, Order::kCoherent, false), "binary_little_endian"));
  const std::string expected = Expected();
  EXPECT_EQ(Sample({"--resume"}).status, 0);
  EXPECT_EQ(ResumedAt(), 0u);
  EXPECT_TRUE(ReadText(output_) == expected);
}

TEST_F(Resume, AlsoGoesOnAfterAnInterruptThatItWasToldOf) {
  for (const bool told : {true, false}) {
    SCOPED_TRACE(told);
    const auto strata = StoppedAfterCheckpoint(
        Arguments(told ? std::vector<std::string>{"--resume"} : std::vector<std::string>{}));
    strata->Signal(SIGTERM);
    strata->Signal(SIGCONT);
    EXPECT_EQ(strata->Wait(), 128 + SIGTERM);
    EXPECT_THAT(outputs_.Names(), IsEmpty());
    EXPECT_EQ(!FolderWithCheckpoint().empty(), told);
    if (!told) continue;
    const std::string expected = Expected();
    ExpectDone(Sample({"--resume"}), expected);
    EXPECT_GT(ResumedAt(), 0u);
    fs::remove(output_);
    fs::remove(summary_);
  }
}

TEST_F(Resume, LeavesALivingProcessItsFolder) {
  const std::string expected = Expected();
  const auto first = StoppedAfterCheckpoint(Arguments());
  for (const std::vector<std::string>& more :
       std::vector<std::vector<std::string>>{{}, {"--resume"}}) {
    const Outcome second = Sample(more);
    EXPECT_EQ(second.status, 0) << second.err;
    EXPECT_EQ(ResumedAt(), 0u);
    EXPECT_TRUE(ReadText(output_) == expected);
    EXPECT_FALSE(FolderWithCheckpoint().empty());
  }
  first->Signal(SIGCONT);
  EXPECT_EQ(first->Wait(), 0) << first->Err();
  EXPECT_TRUE(ReadText(output_) == expected);
  EXPECT_THAT(scratch_.Names(), IsEmpty());
}

TEST_F(Resume, TrustsNoFolderThatOthersCouldWriteTo) {
  const std::string expected = Expected();
  const std::string folder = KillAfterCheckpoint();
  fs::permissions(folder, fs::perms::all);
  const Outcome outcome = Sample({"--resume"});
  EXPECT_EQ(outcome.status, 0) << outcome.err;
  EXPECT_EQ(ResumedAt(), 0u);
  EXPECT_TRUE(ReadText(output_) == expected);
}

TEST_F(Resume, NamesADamagedCheckpointAndSaysWhatToDo) {
  const std::string folder = KillAfterCheckpoint();
  const std::string bytes = ReadText(folder + "/checkpoint");
  WriteFile(folder + "/checkpoint", bytes.substr(0, bytes.size() - 1));
  const Outcome outcome = Sample({"--resume"});
  EXPECT_EQ(outcome.status, 8);
  EXPECT_THAT(outcome.err, HasSubstr("checkpoint"));
  EXPECT_THAT(outcome.err, HasSubstr("start without --resume"));
  EXPECT_THAT(outputs_.Names(), IsEmpty());
}

TEST_F(Resume, NamesRunsThatWereCutAndSaysWhatToDo) {
  const std::string folder = KillAfterCheckpoint();
  fs::resize_file(folder + "/runs", 100);
  const Outcome outcome = Sample({"--resume"});
  EXPECT_EQ(outcome.status, 8);
  EXPECT_THAT(outcome.err, HasSubstr("found 100 bytes of runs"));
  EXPECT_THAT(outcome.err, HasSubstr("start without --resume"));
}

TEST_F(Resume, ServesSharesOfAMeshToo) {
  std::vector<std::string> scan = {"scan",      mesh_,           "--share",      "0/2",
                                   "-o",        output_,         "--memory",     "64M",
                                   "--scratch", scratch_.path(), "--resolution", "440"};
  ASSERT_EQ(test::Run(STRATA_BINARY, scan).status, 0);
  const std::string expected = ReadText(output_);
  fs::remove(output_);
  const auto strata = StoppedAfterCheckpoint(scan);
  strata->Signal(SIGKILL);
  ASSERT_EQ(strata->Wait(), 1000 + SIGKILL);
  scan.push_back("--resume");
  const Outcome outcome = test::Run(STRATA_BINARY, scan);
  EXPECT_EQ(outcome.status, 0) << outcome.err;
  EXPECT_TRUE(ReadText(output_) == expected);
  EXPECT_THAT(scratch_.Names(), IsEmpty());
}

}  // namespace
}  // namespace strata::test
