// Globs over paths.
#pragma once

#include <string_view>

namespace strata::server {

/// Whether the whole of `path` matches `glob`, byte by byte: `?` is one byte, `*` any number, both
/// without '/'; `**` any number with '/', and "**/" also nothing; `[a-z]`, `[!a-z]` one byte of a
/// set; `\` takes the next byte as it is. A glob without '/' is matched against the last segment
/// alone, as "**/GLOB". A '/' at the front (or "./") binds to the root, as for `path` itself, which
/// has none; one at the end stands for all that lies below the folders that the rest matches.
/// Time: at most length times length, times the number of folders.
bool MatchesGlob(std::string_view glob, std::string_view path);

/// Whether the glob, which ends with "/" or "/**", matches whatever lies below `folder`: then
/// nothing there needs to be looked at.
bool MatchesAllBelow(std::string_view glob, std::string_view folder);

}  // namespace strata::server
