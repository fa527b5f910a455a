// The options of `strata batch` and `strata report`: names, groups and help in one table each.
#pragma once

#include <span>

namespace strata::server {

/// An option, or a flag where `value` is null.
struct BatchOption {
  const char* names;      ///< As CLI11 takes them: "-o,--output".
  const char* value;      ///< The value's name in the help.
  const char* group;      ///< Heading in the help.
  const char* help;       ///< What it does, unit, range, default; lines of at most 64 characters.
  bool repeated = false;  ///< May be given several times.
};

/// In the order of the help, without the options of the samples, which are those of `strata sample`
/// (IsModelOption). The rows live as long as the program.
std::span<const BatchOption> BatchOptions();
std::span<const BatchOption> ReportOptions();

}  // namespace strata::server
