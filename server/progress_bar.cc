#include "server/progress_bar.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <string_view>

#include "core/stopwatch.h"
#include "server/human_units.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kRedraw{100};
constexpr int kBarWidth = 20;

const char* StageName(RunContext::Stage stage) {
  constexpr std::array<const char*, 5> kNames = {"opening", "scanning", "rejecting", "writing",
                                                 "done"};
  return kNames[static_cast<std::size_t>(stage)];
}

bool CanDraw(int fd) {
  const char* const terminal = std::getenv("TERM");
  return terminal && std::string_view(terminal) != "dumb" && isatty(fd) == 1;
}

/// A lost progress line is no failure of the job.
void Draw(int fd, std::string_view text) {
  const std::string line = "\r" + std::string(text) + "\x1b[K";
  [[maybe_unused]] const ssize_t written = write(fd, line.data(), line.size());
}

std::string Bar(double share) {
  const int filled = static_cast<int>(share * kBarWidth);
  return '[' + std::string(static_cast<std::size_t>(filled), '#') +
         std::string(static_cast<std::size_t>(kBarWidth - filled), ' ') + "] " +
         std::to_string(static_cast<int>(share * 100)) + " %";
}

}  // namespace

std::string ProgressLine(const ProgressState& state) {
  std::string line = StageName(state.stage);
  if (state.total > 0) {
    line += ' ' +
            Bar(std::min(static_cast<double>(state.done) / static_cast<double>(state.total), 1.0));
  }
  if (!(state.seconds > 0)) return line;
  const double bytes_per_second = static_cast<double>(state.bytes) / state.seconds;
  const double triangles_per_second = static_cast<double>(state.triangles) / state.seconds;
  if (triangles_per_second > 0) line += "  " + Si(triangles_per_second) + " triangles/s";
  if (bytes_per_second > 0) line += "  " + Si(bytes_per_second) + "B/s";
  if (bytes_per_second > 0 && state.done < state.total) {
    line +=
        "  " + Seconds(static_cast<double>(state.total - state.done) / bytes_per_second) + " left";
  }
  return line.substr(0, 79);
}

ProgressBar::ProgressBar(const RunContext& context, bool wanted, int fd)
    : context_(context), fd_(fd) {
  if (wanted && CanDraw(fd)) thread_ = std::thread([this] { Run(); });
}

void ProgressBar::Stop() {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  wake_.notify_one();
  thread_.join();
  Draw(fd_, "");
}

void ProgressBar::Run() {
  ProgressState state;
  Stopwatch watch;
  std::uint64_t first_byte = 0, first_triangle = 0;
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, kRedraw, [this] { return stopped_; })) {
    const std::uint64_t done = context_.done(), triangles = context_.triangles();
    // A second pass over the input counts its bytes from the start again: its rates are its own.
    if (context_.stage() != state.stage || done < state.done) {
      watch = {};
      first_byte = done;
      first_triangle = triangles;
    }
    state = {context_.stage(),           done,           context_.total(), done - first_byte,
             triangles - first_triangle, watch.seconds()};
    Draw(fd_, ProgressLine(state));
  }
}

}  // namespace strata::server
