// `strata serve`.
#pragma once

#include <span>
#include <string>

#include "core/result.h"

namespace strata::server {

/// Serves until SIGTERM, SIGINT or SIGHUP, then drains. Make no thread before it. `arguments` are
/// those after "serve". Errors: those of ParseServe; a port in use, certificates, keys.
Result<void> RunServe(std::span<const std::string> arguments);

/// `strata worker`: runs jobs of a shared database until one of these signals; then it finishes
/// those that run, or, after --drain-timeout, gives them back. `arguments` are those after
/// "worker".
Result<void> RunWorkerNode(std::span<const std::string> arguments);

}  // namespace strata::server
