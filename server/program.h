// What the programs `strata` and `strata-serve` have in common: how they start, and how they end.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// Whether a command is one of the program `strata-serve`: `serve`, `key`, `health`, `batch`,
/// `report`.
bool IsServiceCommand(std::string_view name);

/// Prints the error, and returns the exit status that goes with it: that of `signal`, if one (not
/// 0) is why the work was cancelled.
int Report(const Error& error, int signal);

/// Runs a program's work with its arguments, without its name, and returns its exit status. What
/// escapes `work` as an exception is reported.
int RunProgram(int argc, char** argv,
               const std::function<int(const std::vector<std::string>&)>& work);

}  // namespace strata::server
