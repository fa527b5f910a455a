// Completion for shells out of what --help prints.
#pragma once

#include <span>
#include <string>

#include "server/command_text.h"

namespace strata::server {

/// What to offer where a value is expected.
enum class ValueKind { kNone, kWords, kFile, kFolder, kOther };

/// Told by the value's name in the help: "on|off", "FILE", "DIR". A positional's by its own.
ValueKind KindOf(const OptionText& option);

/// The scripts. `all` holds `strata` itself, too. Needs bash 4.4; zsh and fish as Debian 12 has
/// them.
std::string BashCompletion(std::span<const CommandText> all);
std::string ZshCompletion(std::span<const CommandText> all);
std::string FishCompletion(std::span<const CommandText> all);

}  // namespace strata::server
