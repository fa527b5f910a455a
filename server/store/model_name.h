// What a model may be called.
#pragma once

#include <string_view>

#include "core/result.h"

namespace strata::server {

inline constexpr std::size_t kMaxModelNameBytes = 255;

/// A name is 1 to 512 bytes of UTF-8 in segments divided by '/': "cars/mini.ply". A segment has 1
/// to 255 bytes, does not begin with a dot, and holds no backslash and no control character (C0,
/// DEL, C1, the line and paragraph separators). So a name stays in its folder, is no hidden file,
/// and prints on one line. Names are compared as bytes: two normal forms are two names. Errors:
/// kInvalidArgument, saying which rule at which byte.
Result<void> CheckModelName(std::string_view name);

}  // namespace strata::server
