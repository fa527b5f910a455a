// A command as its users read it: what --help prints, as data, for man pages and shell completion.
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace strata::server {

/// An option or a positional argument.
struct OptionText {
  std::vector<std::string> names;  ///< "-o", "--output"; of a positional its one name, "INPUT".
  std::string value;               ///< Its value's name in the help; empty for a flag.
  std::string group;               ///< Heading in the help.
  std::string help;                ///< What it does; may hold line breaks.
  bool positional = false;
};

/// `strata NAME`, or `strata` itself.
struct CommandText {
  std::string name;     ///< "sample"; empty for `strata` itself.
  std::string summary;  ///< One sentence, with its full stop.
  std::string usage;    ///< Lines of "strata …".
  std::vector<OptionText> options;
  std::string footer;  ///< What stands under the options: blocks that begin "Examples:" and so on.
};

/// What `app` prints for --help; `name` as in CommandText.
CommandText Describe(const CLI::App& app, std::string name);

/// The words that a value may be, where its name in the help lists them: of "on|off" on and off.
/// Empty for any other.
std::vector<std::string> WordsOf(const OptionText& option);

}  // namespace strata::server
