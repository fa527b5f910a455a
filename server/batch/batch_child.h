// The process of a batch that the service runs.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// The arguments that follow `strata batch` for a request; `models` and `out` as its REPO and OUT.
/// Precondition: the options have been checked.
struct BatchChildPlan {
  std::vector<std::string> arguments;
  std::string log;                       ///< A file for what it says; replaced.
  std::vector<std::string> environment;  ///< "NAME=VALUE" besides this process's own.
};

/// The internal command of such a process: kBatchChildCommand PARENT ARGUMENTS…
inline constexpr const char* kBatchChildCommand = "run-batch";

/// Starts this program anew with the plan's arguments, in a process group of its own and without
/// any descriptor of this process's. It is killed when the calling thread ends. Errors: kIo.
Result<pid_t> StartBatchChild(const BatchChildPlan& plan);

/// The first thing that such a process does. False: its parent, PARENT, has died, and it has to
/// end.
bool EnterBatchChild(const std::string& parent);

}  // namespace strata::server
