// The description of the HTTP API.
#pragma once

#include <string_view>

namespace strata::server {

/// openapi.json as it stands in the source: OpenAPI 3.1.
std::string_view OpenApiText();

}  // namespace strata::server
