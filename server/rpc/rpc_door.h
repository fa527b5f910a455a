// Takes connections for gRPC, which by itself takes any number.
#pragma once

#include <grpcpp/server_builder.h>

#include <cstdint>
#include <memory>
#include <set>
#include <thread>

#include "core/result.h"
#include "io/fd.h"
#include "server/service/metrics.h"

namespace strata::server {

/// Accepts, counts, and hands over; who comes when `most` are open is closed at once. Threads:
/// Start and Close from one.
class RpcDoor {
 public:
  using Acceptor = grpc::experimental::ExternalConnectionAcceptor;

  struct Options {
    io::Fd listener;
    std::uint32_t most = 0;  ///< Connections open at a time.
  };

  /// `metrics` must outlive it.
  RpcDoor(Options options, Metrics& metrics);
  ~RpcDoor();

  /// Once the server runs. Errors: kIo (out of descriptors).
  Result<void> Start(std::unique_ptr<Acceptor> acceptor);
  /// Takes no more. Those that are open stay so, and are gRPC's.
  void Close();

 private:
  void Run();
  void AcceptOne();
  void HandOver(io::Fd socket);
  void Forget(int watched);

  const Options options_;
  Metrics& metrics_;
  std::unique_ptr<Acceptor> acceptor_;
  io::Fd events_, stop_;
  std::set<int> watched_;  // Used by thread_ alone while it runs.
  std::thread thread_;
};

}  // namespace strata::server
