// Man pages out of what --help prints.
#pragma once

#include <span>
#include <string>

#include "server/command_text.h"

namespace strata::server {

/// What stands at the edges of every page.
struct PageEdge {
  std::string version;  ///< "0.1.0".
  std::string date;     ///< "2026-01-31".
};

/// "strata" for `strata` itself, else "strata-NAME".
std::string PageName(const CommandText& command);

/// The page of section 1 in roff, of the macros of man(7). `all` are the commands that it points
/// to; the page of `strata` itself lists them.
std::string ManPage(const CommandText& command, std::span<const CommandText> all,
                    const PageEdge& edge);

}  // namespace strata::server
