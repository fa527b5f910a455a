// What a request's header must say, and say once, before its target and body are looked at
// (RFC 9112, 3.2 and 6.3).
#pragma once

#include "server/http/http_exchange.h"

namespace strata::server {

/// A request whose end, or whose host, another server on its way may see elsewhere is none: what
/// follows could be smuggled past that server's rules. Refuses: kMalformed (no Host, several of
/// them, or a Transfer-Encoding in HTTP/1.0), kNotImplemented (a transfer coding besides chunked).
/// The caller closes the connection, since where the body ends is not known.
Answer<void> CheckFraming(const RequestParser& parser);

}  // namespace strata::server
