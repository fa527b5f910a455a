// The line on a terminal that says how far a job is.
#pragma once

#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "core/run_context.h"

namespace strata::server {

/// While it lives, redraws one line on `fd` ten times a second: stage, share done, triangles/s,
/// MB/s, time left. Erases it at the end. Does nothing at all, not even start its thread, when `fd`
/// is not a terminal, when TERM is "dumb" or unset, or when not `wanted`.
class ProgressBar {
 public:
  ProgressBar(const RunContext& context, bool wanted, int fd = 2);
  ~ProgressBar() { Stop(); }
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// Erases the line and ends the thread; may be called again.
  void Stop();

 private:
  void Run();

  const RunContext& context_;
  const int fd_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stopped_ = false;
  std::thread thread_;
};

/// One state of a stage, for the line's text.
struct ProgressState {
  RunContext::Stage stage = RunContext::Stage::kOpen;
  std::uint64_t done = 0, total = 0;  ///< Bytes of input; total 0 = unknown.
  std::uint64_t bytes = 0;            ///< Of `done`, since the stage began.
  std::uint64_t triangles = 0;        ///< Since the stage began.
  double seconds = 0;                 ///< Since the stage began.
};

/// The line, without control characters, at most 79 characters.
std::string ProgressLine(const ProgressState& state);

}  // namespace strata::server
