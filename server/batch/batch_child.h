// The process of a batch that the service runs.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// The arguments of `strata batch` for a request; `models` and `out` as its REPO and OUT.
/// Precondition: the options have been checked.
struct BatchChildPlan {
  std::vector<std::string> arguments;
  std::string log;  ///< A file for what it says; replaced.
};

/// Starts this program anew with the plan's arguments, in a process group of its own and without
/// any descriptor of this process's. It is killed when the calling thread ends. Errors: kIo.
Result<pid_t> StartBatchChild(const BatchChildPlan& plan);

}  // namespace strata::server
