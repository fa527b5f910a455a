// Which endpoint a request is for, and whether its sender may use it.
#pragma once

#include <span>
#include <string>

#include "server/http/exchange.h"
#include "server/service/service.h"

namespace strata::server {

/// One row of the table of endpoints.
struct Route {
  const char* method;  ///< "GET" answers HEAD too.
  /// As in OpenAPI: "/v1/jobs/{id}/result". A {name} stands for one segment, {name...} for the
  /// rest.
  const char* path;
  enum class Access { kOpen, kRead, kFull } access;  ///< kOpen: without a key.
  bool counted;  ///< Takes one of the places for requests in flight.
  void (*handle)(Service& service, Exchange& exchange, const std::string& parameter);
};

/// Every endpoint.
std::span<const Route> Routes();

/// What the log says of a request beyond its answer.
struct Routed {
  const char* endpoint = "none";  ///< The row's path.
  std::string caller = "none";    ///< The key's name.
};

/// Finds the row, checks the key, takes a place, calls the handler. Always answers.
Routed Dispatch(Service& service, Exchange& exchange);

}  // namespace strata::server
