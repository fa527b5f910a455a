// What stands after the method in a request line.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/service/problem.h"

namespace strata::server {

/// A target, decoded.
struct RequestTarget {
  std::string authority;                                   ///< Of the absolute form; else empty.
  std::string path;                                        ///< "/v1/samples"; begins with "/".
  std::vector<std::pair<std::string, std::string>> query;  ///< In order.
};

/// Decodes "/path?name=value&…", also after "http://host:port" (which proxies are sent, and which
/// goes before the header Host). `%XX` stands for a byte, `+` for itself.
/// Refuses kMalformed: no path, a broken escape, a control character or NUL (also decoded),
/// bytes that are not UTF-8.
Answer<RequestTarget> ParseTarget(std::string_view target);

}  // namespace strata::server
