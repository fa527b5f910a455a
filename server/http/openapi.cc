#include "server/http/openapi.h"

#include "server/http/embedded_file.h"

namespace strata::server {

std::string_view OpenApiText() { return kOpenApiFiles.front().text(); }

}  // namespace strata::server
