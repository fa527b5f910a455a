// `strata batch` and `strata report`, from arguments to exit status.
#pragma once

#include <span>
#include <string>

#include "core/result.h"

namespace strata::server {

/// The arguments after the command's name. Returns the exit status: 0, or 1 when models failed.
/// Errors: those of ParseBatch, RunBatch, ParseReport, RunReport. `signal` is then the one that
/// ended it, or 0.
Result<int> BatchMain(std::span<const std::string> arguments, int& signal);
Result<int> ReportMain(std::span<const std::string> arguments);

}  // namespace strata::server
