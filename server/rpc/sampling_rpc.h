// strata.v1.Sampling over gRPC.
#pragma once

#include "server/rpc/call_watch.h"
#include "server/service/service.h"
#include "strata/v1/sampling.grpc.pb.h"

namespace strata::server {

/// Threads: gRPC's.
class SamplingRpc final : public v1::Sampling::Service {
 public:
  SamplingRpc(server::Service& service, CallWatch& watch) : service_(service), watch_(watch) {}

  grpc::Status Sample(
      grpc::ServerContext* context,
      grpc::ServerReaderWriter<v1::SampleResponse, v1::SampleRequest>* stream) override;

 private:
  server::Service& service_;
  CallWatch& watch_;
};

}  // namespace strata::server
