// Asks a running service how it is: the client's side of /livez and /readyz.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

#include "core/result.h"

namespace strata::server {

/// Where to ask.
struct HealthUrl {
  bool tls = false;
  std::string host = "127.0.0.1";
  std::string port = "8080";
  std::string path = "/livez";
};

/// "http://HOST[:PORT][/PATH]" or "https://…"; an IPv6 address in brackets. What is left out is as
/// in HealthUrl, but port 443 for https. Errors: kInvalidArgument.
Result<HealthUrl> ParseHealthUrl(std::string_view text);

/// One GET. Succeeds when the answer's status is 200 within `timeout`. A certificate is not
/// checked: nothing secret is sent, and what comes back is a status. Errors: kIo, saying what came
/// instead.
Result<void> ProbeHealth(const HealthUrl& url, std::chrono::seconds timeout);

}  // namespace strata::server
