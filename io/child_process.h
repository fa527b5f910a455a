// A program that does for Strata what Strata's own process should not.
#pragma once

#include <sys/types.h>

#include <span>
#include <string>
#include <vector>

namespace strata::io {

/// A process with an empty environment and no descriptor but those it is given; killed and reaped
/// when this goes. Threads: one at a time.
class ChildProcess {
 public:
  /// `descriptor` of this process becomes the child's `number`, below 100. Standard streams that
  /// nobody names are /dev/null.
  struct Opening {
    int descriptor;
    int number;
  };

  ChildProcess() = default;
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;
  ~ChildProcess();

  /// Starts `program` (a path). Signals that a terminal or a scheduler sends to the whole group do
  /// not reach it: what they mean is this process's to decide. Returns errno; 0 is success.
  /// Preconditions: not started yet; openings by ascending number.
  int Start(const std::string& program, std::vector<std::string> arguments,
            std::span<const Opening> openings);

  /// Waits for its end and says how it came: "ended too early, with status 3", "was killed by
  /// signal 9 (Killed)"; "is gone" from then on. Precondition: started.
  std::string WaitForEnd();

 private:
  int Reap();
  pid_t id_ = -1;
};

}  // namespace strata::io
