// What joins a request, its answer, its log line and the traces of others.
#pragma once

#include <string>

namespace strata::server {

/// `asked`, what the client calls its request, if it is 1 to 64 letters, digits, - _ or .; else a
/// new id of 16 hex digits.
std::string RequestIdOf(const std::string& asked);

/// `text` if it is a W3C traceparent of version 00, else "".
std::string TraceParentOf(const std::string& text);

}  // namespace strata::server
