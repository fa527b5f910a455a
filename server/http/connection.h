// Serves one connection: request after request until it ends.
#pragma once

#include <memory>

#include "server/http/browser_guard.h"
#include "server/http/exchange.h"
#include "server/http/transport.h"
#include "server/service/service.h"

namespace strata::server {

/// What all connections share. Threads: any.
struct HttpShared {
  Service& service;
  const HttpLimits limits;
  int stop = -1;  ///< An eventfd: readable when no further request is to be read.
  const BrowserGuard guard = {};
};

/// Serves `transport` until the peer goes, an error, a limit or `stop`. Blocks.
void ServeConnection(const HttpShared& shared, Transport& transport);

}  // namespace strata::server
