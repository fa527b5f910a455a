#include "server/http/openapi.h"

namespace strata::server {

extern const unsigned char kOpenApiBytes[];
extern const unsigned long kOpenApiSize;

std::string_view OpenApiText() {
  return {reinterpret_cast<const char*>(kOpenApiBytes), kOpenApiSize};
}

}  // namespace strata::server
