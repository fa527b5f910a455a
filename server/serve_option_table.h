// The options of `strata serve`: names, groups, help and defaults in one table, for the command
// line and strata.toml alike.
#pragma once

#include <map>
#include <span>
#include <string>
#include <string_view>

namespace strata::server {

/// An option: "--name VALUE" on the command line, `name = VALUE` in strata.toml.
struct ServeOption {
  const char* name;      ///< Without dashes before it: "body-size".
  const char* value;     ///< The value's name in the help.
  const char* group;     ///< Heading in the help.
  const char* help;      ///< What it does, unit, range; the default is added.
  const char* standard;  ///< The default's text, as an option would say it; "" = none.
  /// What the help says in place of `standard` where the default depends on the machine; or null.
  const char* computed = nullptr;
  /// May be given several times, in strata.toml as a list; its text is then the values with ","
  /// between them.
  bool repeated = false;
};

/// In the order of the help. The rows live as long as the program.
std::span<const ServeOption> ServeOptions();

/// Whether `strata worker` has it too.
bool IsWorkerOption(std::string_view name);

/// Name → text of the options that were given, the command line's before the file's.
using ServeTexts = std::map<std::string, std::string>;

}  // namespace strata::server
