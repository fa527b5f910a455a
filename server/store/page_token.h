// Where a list goes on: opaque to clients, readable to us.
#pragma once

#include <string>
#include <string_view>

#include "core/result.h"

namespace strata::server {

/// Pages hold 1 to this many entries.
inline constexpr std::size_t kMaxPageSize = 1000;

/// Hex digits, which pass unharmed through every address. `kind` tells one list's tokens from
/// another's; `last` is the key of the last entry given out.
std::string MakePageToken(char kind, std::string_view last);

/// The key in a token; "" for an empty token. Errors: kInvalidArgument for what MakePageToken did
/// not make for this kind.
Result<std::string> ReadPageToken(char kind, std::string_view token);

/// Errors: kInvalidArgument unless 1 <= size <= kMaxPageSize.
Result<void> CheckPageSize(std::size_t size);

}  // namespace strata::server
