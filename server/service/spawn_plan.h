// How this program starts itself again.
#pragma once

#include <spawn.h>
#include <sys/types.h>

#include <string>
#include <vector>

#include "io/fd.h"

namespace strata::server {

/// Attributes and actions of a child's start, by posix_spawn: a fork in a process with threads may
/// find the allocator locked. The child has a process group of its own, so that Ctrl-C in the
/// parent's terminal is the parent's to handle, and signals as at a program's usual start. Threads:
/// one.
class SpawnPlan {
 public:
  SpawnPlan();
  ~SpawnPlan();
  SpawnPlan(const SpawnPlan&) = delete;
  SpawnPlan& operator=(const SpawnPlan&) = delete;

  /// The child gets a copy of `fd`, which must live until Run and be above all such numbers; none,
  /// if it is not open.
  void Give(const io::Fd& fd, int number);
  /// Starts the program's own binary. Descriptors that are not close-on-exec are inherited.
  /// `environment` has what the child's has besides this process's: "NAME=VALUE". Returns 0 or an
  /// errno.
  int Run(std::vector<std::string> arguments, pid_t& id, std::vector<std::string> environment = {});

 private:
  posix_spawn_file_actions_t actions_;
  posix_spawnattr_t attributes_;
};

/// A copy above the numbers that a child gets, so that none is overwritten before it is copied.
io::Fd OutOfTheWay(int fd);

}  // namespace strata::server
