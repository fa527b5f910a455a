// The small commands beside `strata serve`: `strata key` and `strata health`.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/command_text.h"

namespace strata::server {

/// `strata key NAME [--role full|read]`: prints a new key to standard error and its line for the
/// file of `--keys` to standard output. `arguments` are those after "key". Errors:
/// kInvalidArgument, kIo.
Result<void> RunKey(std::span<const std::string> arguments);

/// `strata health [URL]`: whether a service answers with 200. Prints nothing where it does. Errors:
/// kInvalidArgument; kIo, saying what came instead.
Result<void> RunHealth(std::span<const std::string> arguments);

/// What their --help prints.
std::vector<CommandText> DescribeServiceTools();

}  // namespace strata::server
