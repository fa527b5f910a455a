// `strata serve`, `strata key`, and the child that runs one job.
#pragma once

#include <span>
#include <string>

#include "core/result.h"

namespace strata::server {

/// Serves until SIGTERM, SIGINT or SIGHUP, then drains. Make no thread before it. `arguments` are
/// those after "serve". Errors: those of ParseServe; a port in use, certificates, keys.
Result<void> RunServe(std::span<const std::string> arguments);

/// `strata key NAME [--role full|read]`: prints a new key to standard error and its line for the
/// file of `--keys` to standard output. Errors: kInvalidArgument, kIo.
Result<void> RunKey(std::span<const std::string> arguments);

}  // namespace strata::server
