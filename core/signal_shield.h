// Writes that must fail as errors, not end the process.
#pragma once

#include <csignal>
#include <initializer_list>

namespace strata {

/// While it lives, a write to a closed pipe (SIGPIPE) or past the file size limit (SIGXFSZ) is an
/// errno, not the process's death: the signals are blocked in this thread, and what its own writes
/// raised is consumed. Threads: made and destroyed by one.
class SignalShield {
 public:
  explicit SignalShield(std::initializer_list<int> signals);
  ~SignalShield();
  SignalShield(const SignalShield&) = delete;
  SignalShield& operator=(const SignalShield&) = delete;

 private:
  sigset_t set_, old_;
  bool had_pending_ = false;
};

}  // namespace strata
