// Ctrl-C and its kin: stop soon, leave nothing behind.
#pragma once

#include <signal.h>

#include <atomic>
#include <chrono>
#include <thread>

#include "core/run_context.h"

namespace strata::server {

/// While it lives, SIGINT, SIGTERM and SIGHUP cancel `context`. If the guard still lives half a
/// second later, or a second signal comes, unfinished outputs are removed and the process ends with
/// 128 + the signal's number. A signal that the process was started with as ignored (nohup) stays
/// ignored.
///
/// Make it before any other thread: the signals are blocked in this thread and in those it starts,
/// and a thread of the guard waits for them. No code runs inside a signal handler.
class InterruptGuard {
 public:
  explicit InterruptGuard(RunContext& context);
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

  /// The signal that came, or 0.
  int signal() const { return signal_.load(); }

 private:
  void Watch();
  int Next(std::chrono::milliseconds timeout) const;

  RunContext& context_;
  std::atomic<int> signal_{0};
  sigset_t former_mask_{};
  int signals_ = -1;  // A signalfd.
  int stop_ = -1;     // An eventfd: readable once the guard ends.
  std::thread watcher_;
};

}  // namespace strata::server
