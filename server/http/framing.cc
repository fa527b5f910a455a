#include "server/http/framing.h"

#include <boost/beast/core/string.hpp>
#include <boost/beast/http/field.hpp>
#include <string>

namespace strata::server {
namespace {

namespace http = boost::beast::http;

}  // namespace

Answer<void> CheckFraming(const RequestParser& parser) {
  const auto& fields = parser.get().base();
  const bool old = parser.get().version() < 11;
  const std::size_t hosts = fields.count(http::field::host);
  if (hosts > 1 || (hosts == 0 && !old)) {
    return Refuse(Refusal::kMalformed, "Host: found " + std::to_string(hosts) + ", expected one");
  }
  const auto [first, last] = fields.equal_range(http::field::transfer_encoding);
  for (auto field = first; field != last; ++field) {
    if (old) {
      return Refuse(Refusal::kMalformed, "Transfer-Encoding: found in HTTP/1.0, which has none");
    }
    if (!boost::beast::iequals(field->value(), "chunked")) {
      return Refuse(
          Refusal::kNotImplemented,
          "Transfer-Encoding: found '" + std::string(field->value()) + "', expected chunked");
    }
  }
  return {};
}

}  // namespace strata::server
