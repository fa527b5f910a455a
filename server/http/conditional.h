// Entity tags and ranges (RFC 9110, 13 and 14).
#pragma once

#include "server/http/exchange.h"

namespace strata::server {

/// Answers with `content`, in whole or the one range that `Range` asks for: 200, 206, 304 (by
/// If-None-Match), 412 (by If-Match) or 416. More than one range is answered in whole.
void RespondConditional(Exchange& exchange, const Content& content, Headers headers);

/// How weak tags compare: If-Match asks for the same bytes, If-None-Match takes `W/"x"` for "x",
/// which is what a proxy that compresses makes of it.
enum class TagMatch { kStrong, kWeak };

/// Whether `tag`, a strong one, stands in a list of entity tags, or the list is "*".
bool HasTag(const std::string& list, const std::string& tag, TagMatch match);

}  // namespace strata::server
