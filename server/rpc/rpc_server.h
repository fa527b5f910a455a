// Listens for gRPC.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>

#include "core/result.h"
#include "server/service/service.h"

namespace strata::server {

/// Threads: Start, Stop and the destructor from one.
class RpcServer {
 public:
  struct Options {
    std::string address;     ///< An IPv4 or IPv6 address.
    std::uint16_t port = 0;  ///< 0: any free one.
    // PEM texts; empty certificate: plain. client_ca: clients must show a certificate.
    std::string certificate, key, client_ca;
    std::uint32_t connections = 512;  ///< Open at a time.
    std::uint32_t header_bytes = 16 << 10;
    std::uint32_t header_seconds = 10;      ///< For TLS's handshake and the first settings.
    std::uint32_t idle_seconds = 60;        ///< A connection without a call is closed after these.
    std::uint64_t bytes_per_second = 1024;  ///< Slower streams are ended, …
    std::uint32_t grace_seconds = 10;       ///< … beyond the first seconds.
  };

  /// `service` must outlive it. With grpc.health.v1 and reflection. Errors: kIo (port in use, …),
  /// kInvalidArgument (certificates).
  static Result<std::unique_ptr<RpcServer>> Start(const Options& options, Service& service);
  ~RpcServer();

  std::uint16_t port() const;
  /// Health says NOT_SERVING from now on.
  void StopServing();
  /// Takes no new call, and ends those that are left at `deadline`. Blocks until all have ended.
  void Close(std::chrono::system_clock::time_point deadline);

 private:
  struct State;
  explicit RpcServer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace strata::server
