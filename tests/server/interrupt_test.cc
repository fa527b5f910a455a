// Ctrl-C and its kin, on the command itself.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <fstream>
#include <ostream>
#include <sstream>
#include <string>

#include "tests/support/process.h"
#include "tests/support/shapes.h"

namespace strata::test {
namespace {

using testing::IsEmpty;
using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Processor seconds that a process has used so far.
double CpuSeconds(pid_t id) {
  std::ifstream stat("/proc/" + std::to_string(id) + "/stat");
  std::string text((std::istreambuf_iterator<char>(stat)), {});
  std::istringstream fields(text.substr(text.rfind(')') + 1));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;
  double user = 0, system = 0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

struct Case {
  const char* name;
  int signal;
  int status;
  friend void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }
};
class Interrupt : public testing::TestWithParam<Case> {};

TEST_P(Interrupt, StopsAReadThatNeverEndsAndLeavesNoFile) {
  const ScratchFolder folder;
  Child strata(STRATA_BINARY, {"sample", "-", "-o", folder / "out.ply"});
  // More than a pipe holds: once it is taken, the command is reading.
  ASSERT_TRUE(strata.Feed(SheetObj(200))) << strata.Err();
  strata.Signal(GetParam().signal);
  EXPECT_EQ(strata.Wait(), GetParam().status) << strata.Err();
  EXPECT_THAT(folder.Names(), IsEmpty());
}

TEST_P(Interrupt, StopsTheScanAndLeavesNoFile) {
  const ScratchFolder folder;
  const ScratchFolder input;
  WriteFile(input / "in.obj", CubeObj());
  // Two thousand million cells: far more than a second's work.
  Child strata(STRATA_BINARY, {"sample", input / "in.obj", "-o", folder / "out.ply", "--resolution",
                               "20000", "--summary", folder / "out.json"});
  const auto begun = Clock::now();
  while (CpuSeconds(strata.id()) < 0.2) {
    ASSERT_LT(SecondsSince(begun), 60) << strata.Err();
    sched_yield();
  }
  strata.Signal(GetParam().signal);
  EXPECT_EQ(strata.Wait(), GetParam().status) << strata.Err();
  EXPECT_THAT(folder.Names(), IsEmpty());
}

INSTANTIATE_TEST_SUITE_P(Signals, Interrupt,
                         testing::Values(Case{"SIGINT", SIGINT, 130}, Case{"SIGTERM", SIGTERM, 143},
                                         Case{"SIGHUP", SIGHUP, 129}),
                         [](const auto& each) { return each.param.name; });

TEST(InterruptGuard, LeavesAnIgnoredHangupIgnored) {
  const ScratchFolder folder;
  Child strata(STRATA_BINARY, {"sample", "-", "-o", folder / "out.ply", "--resolution", "8"},
               {.ignored_signal = SIGHUP});
  ASSERT_TRUE(strata.Feed(SheetObj(200)));
  strata.Signal(SIGHUP);
  strata.CloseInput();
  EXPECT_EQ(strata.Wait(), 0) << strata.Err();
  EXPECT_THAT(folder.Names(), testing::ElementsAre("out.ply"));
}

}  // namespace
}  // namespace strata::test
