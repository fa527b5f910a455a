// Listens for HTTP and serves each connection on a thread of its own.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "core/result.h"
#include "server/http/connection.h"
#include "server/http/tls.h"

namespace strata::server {

/// Threads: Start, Stop and the destructor from one.
class HttpServer {
 public:
  struct Options {
    std::string address;     ///< An IPv4 or IPv6 address.
    std::uint16_t port = 0;  ///< 0: any free one.
    HttpLimits limits;
    BrowserGuard guard;
    std::unique_ptr<TlsContext> tls;  ///< Null: plain.
  };

  /// Listens and serves from now on. `service` must outlive it. Errors: kInvalidArgument (address),
  /// kIo (port in use, …).
  static Result<std::unique_ptr<HttpServer>> Start(Options options, Service& service);
  ~HttpServer();

  std::uint16_t port() const;  ///< The one it listens on.
  /// Stops accepting, and reading further requests. Requests that are being served go on.
  void StopAccepting();
  /// Breaks what connections are left and waits until their threads have ended.
  void Close();

 private:
  struct State;
  explicit HttpServer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace strata::server
