// Waiting longer and longer between tries, and at last giving up.
#pragma once

#include <chrono>
#include <functional>
#include <optional>
#include <random>

namespace strata::server {

/// The tries of one request: waits of up to 0.1, 0.2, 0.4, … 20 seconds, each drawn at random from
/// its upper half, so that those who failed together do not come again together.
class Backoff {
 public:
  /// `cancelled` is asked ten times a second while it waits.
  Backoff(int max_attempts, std::function<bool()> cancelled);

  /// After a failed try: false when that was the last one, or the job is cancelled. `wished` is
  /// what the other side asked to wait, of which at most a minute is granted.
  bool Wait(std::optional<std::chrono::seconds> wished);
  /// Begins to count anew: a try got somewhere.
  void Reset() { failed_ = 0; }
  int failed() const { return failed_; }

 private:
  int max_attempts_;
  std::function<bool()> cancelled_;
  int failed_ = 0;
  std::minstd_rand random_;
};

}  // namespace strata::server
