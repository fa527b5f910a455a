// Globs over paths.
#pragma once

#include <string_view>

namespace strata::server {

/// Whether the whole of `path` matches `glob`, byte by byte: `?` is one byte, `*` any number, both
/// without '/'; `**` any number with '/', and "**/" also nothing; `[a-z]`, `[!a-z]` one byte of a
/// set; `\` takes the next byte as it is. A glob without '/' is matched against the last segment
/// alone, as
/// "**/GLOB". Time: at most length times length.
bool MatchesGlob(std::string_view glob, std::string_view path);

}  // namespace strata::server
