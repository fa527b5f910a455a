// What every gRPC call has in common: who asks, a place, a log line, a status with details.
#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <functional>
#include <string>

#include "server/service/service.h"

namespace strata::server {

/// The status of a problem, with a strata.v1.Problem in its details.
grpc::Status StatusOf(const Problem& problem, const std::string& request_id);

/// Bytes of bodies, for the figures.
struct CallBytes {
  std::uint64_t in = 0, out = 0;
};

/// One call: `endpoint` is its method's name. `needed` is what the caller's key must allow.
struct CallFrame {
  Service& service;
  grpc::ServerContext& context;
  const char* endpoint;
  Role needed;
  std::string* client = nullptr;  ///< Takes the name of the caller's key, if it is given.
};

/// Checks the key (metadata "authorization"), takes a place, runs `work`, counts and logs. The
/// request id (metadata "x-request-id", taken from the client or made) goes back in the initial
/// metadata.
grpc::Status RunCall(const CallFrame& frame, const std::function<Answer<void>(CallBytes&)>& work);

}  // namespace strata::server
