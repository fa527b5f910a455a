#include "server/progress_bar.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <string>

namespace strata::server {
namespace {

using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;

/// A terminal: what is written to `slave` is read at `master`.
struct Terminal {
  int master = -1, slave = -1;
  Terminal() { EXPECT_EQ(openpty(&master, &slave, nullptr, nullptr, nullptr), 0); }
  ~Terminal() { close(master), close(slave); }
  std::string ReadSome() const {
    std::array<char, 4096> bytes;
    const ssize_t n = read(master, bytes.data(), bytes.size());
    return {bytes.data(), static_cast<std::size_t>(n > 0 ? n : 0)};
  }
};

TEST(ProgressBar, WritesNothingIntoAPipe) {
  setenv("TERM", "xterm", 1);
  std::array<int, 2> ends{};
  ASSERT_EQ(pipe2(ends.data(), O_NONBLOCK), 0);
  {
    RunContext context;
    ProgressBar bar(context, true, ends[1]);
    bar.Stop();
  }
  char byte = 0;
  EXPECT_EQ(read(ends[0], &byte, 1), -1) << "something was written";
  close(ends[0]), close(ends[1]);
}

TEST(ProgressBar, ShowsTheStageOnATerminalAndErasesIt) {
  setenv("TERM", "xterm", 1);
  const Terminal terminal;
  RunContext context;
  context.SetStage(RunContext::Stage::kScan);
  context.SetProgress(50, 100);
  ProgressBar bar(context, true, terminal.slave);
  EXPECT_THAT(terminal.ReadSome(), AllOf(HasSubstr("scanning"), HasSubstr("50 %")));
  bar.Stop();
  std::string rest = terminal.ReadSome();
  EXPECT_THAT(rest, EndsWith("\r\x1b[K"));
}

TEST(ProgressBar, IsSilentWhenNotWantedOrOnADumbTerminal) {
  const Terminal terminal;
  ASSERT_EQ(fcntl(terminal.master, F_SETFL, O_NONBLOCK), 0);
  RunContext context;
  setenv("TERM", "xterm", 1);
  { const ProgressBar bar(context, false, terminal.slave); }
  setenv("TERM", "dumb", 1);
  { const ProgressBar bar(context, true, terminal.slave); }
  unsetenv("TERM");
  { const ProgressBar bar(context, true, terminal.slave); }
  EXPECT_EQ(terminal.ReadSome(), "");
}

TEST(ProgressLine, HoldsRateAndTimeLeft) {
  const std::string line = ProgressLine({.stage = RunContext::Stage::kScan,
                                         .done = 500'000'000,
                                         .total = 1'000'000'000,
                                         .bytes = 250'000'000,
                                         .triangles = 10'000'000,
                                         .seconds = 2.0});
  EXPECT_THAT(line, AllOf(HasSubstr("scanning"), HasSubstr("50 %"), HasSubstr("5.00 M triangles/s"),
                          HasSubstr("125 MB/s"), HasSubstr("4.00 s left")));
}

TEST(ProgressLine, ClaimsNothingItDoesNotKnow) {
  EXPECT_EQ(ProgressLine({}), "opening");
  const std::string unknown_size =
      ProgressLine({.stage = RunContext::Stage::kScan, .done = 5, .bytes = 5, .seconds = 1.0});
  EXPECT_EQ(unknown_size, "scanning  5 B/s");
}

TEST(ProgressLine, NeverWraps) {
  const std::uint64_t huge = ~std::uint64_t{0};
  EXPECT_LE(ProgressLine({.stage = RunContext::Stage::kReject,
                          .done = huge / 3,
                          .total = huge,
                          .bytes = 1,
                          .triangles = huge,
                          .seconds = 1e8})
                .size(),
            79u);
  EXPECT_THAT(ProgressLine({.stage = RunContext::Stage::kScan, .done = 200, .total = 100}),
              HasSubstr("100 %"));
}

}  // namespace
}  // namespace strata::server
