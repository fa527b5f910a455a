// Entity tags and ranges (RFC 9110, 13 and 14).
#pragma once

#include "server/http/exchange.h"

namespace strata::server {

/// Answers with `content`, in whole or the one range that `Range` asks for: 200, 206, 304 (by
/// If-None-Match), 412 (by If-Match) or 416. More than one range is answered in whole.
void RespondConditional(Exchange& exchange, const Content& content, Headers headers);

/// Whether `tag` stands in a list of entity tags, or the list is "*". Weak ones fit no strong one.
bool HasTag(const std::string& list, const std::string& tag);

}  // namespace strata::server
