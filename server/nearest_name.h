// What somebody probably meant by a name that does not exist.
#pragma once

#include <span>
#include <string>
#include <string_view>

namespace strata::server {

/// The one of `names` that is the fewest single-character edits away from `typed`, or "" when none
/// is within a third of its length.
std::string NearestName(std::string_view typed, std::span<const std::string> names);

}  // namespace strata::server
