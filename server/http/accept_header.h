// Which format an `Accept` header asks for.
#pragma once

#include <string>
#include <string_view>

#include "server/service/problem.h"

namespace strata::server {

/// The name ("drc") of the format that `accept` prefers (RFC 9110, 12.5.1): the highest weight,
/// then the server's order. Empty, */* and application/octet-stream: drc. Refuses: kNotAcceptable,
/// listing what there is.
Answer<std::string> FormatForAccept(std::string_view accept);

}  // namespace strata::server
