#include "server/rpc/rpc_server.h"

#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>

#include <utility>

#include "server/rpc/call_watch.h"
#include "server/rpc/sampling_rpc.h"
#include "server/rpc/stored_rpc.h"

namespace strata::server {
namespace {

// A chunk of 1 MiB, and what a message says around it.
constexpr int kMostMessage = (1 << 20) + (64 << 10);

std::shared_ptr<grpc::ServerCredentials> CredentialsOf(const RpcServer::Options& options) {
  if (options.certificate.empty()) return grpc::InsecureServerCredentials();
  grpc::SslServerCredentialsOptions ssl(
      options.client_ca.empty() ? GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE
                                : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  ssl.pem_root_certs = options.client_ca;
  ssl.pem_key_cert_pairs.push_back({options.key, options.certificate});
  return grpc::SslServerCredentials(ssl);
}

void Bound(grpc::ServerBuilder& builder, const RpcServer::Options& options,
           std::uint32_t requests) {
  builder.SetMaxReceiveMessageSize(kMostMessage);
  builder.AddChannelArgument(GRPC_ARG_MAX_METADATA_SIZE, static_cast<int>(options.header_bytes));
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS, static_cast<int>(requests));
  // A client that is gone without a word is found out.
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 60'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 20'000);
  builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
  grpc::ResourceQuota quota("strata");
  // Each call has a thread; some more, so that those over the limit hear so.
  quota.SetMaxThreads(static_cast<int>(requests) + 32);
  builder.SetResourceQuota(quota);
}

std::string Bracketed(const std::string& address) {
  return address.find(':') == std::string::npos ? address : '[' + address + ']';
}

}  // namespace

struct RpcServer::State {
  State(const Options& options, Service& service)
      : watch({options.bytes_per_second, std::chrono::seconds(options.grace_seconds)}),
        sampling(service, watch),
        models(service, watch),
        jobs(service, watch) {}

  CallWatch watch;
  SamplingRpc sampling;
  ModelsRpc models;
  JobsRpc jobs;
  int port = 0;
  std::unique_ptr<grpc::Server> server;
};

RpcServer::RpcServer(std::unique_ptr<State> state) : state_(std::move(state)) {}
RpcServer::~RpcServer() { Close(std::chrono::system_clock::now()); }

Result<std::unique_ptr<RpcServer>> RpcServer::Start(const Options& options, Service& service) {
  grpc::EnableDefaultHealthCheckService(true);
  grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  auto state = std::make_unique<State>(options, service);
  grpc::ServerBuilder builder;
  Bound(builder, options, service.limits().requests);
  const std::string where = Bracketed(options.address) + ':' + std::to_string(options.port);
  builder.AddListeningPort(where, CredentialsOf(options), &state->port);
  builder.RegisterService(&state->sampling);
  builder.RegisterService(&state->models);
  builder.RegisterService(&state->jobs);
  state->server = builder.BuildAndStart();
  if (!state->server || state->port == 0) {
    return Fail(ErrorCode::kIo, "cannot listen for gRPC on " + where +
                                    ": the port is in use, or the certificate and key do not fit");
  }
  for (const char* const name : {"strata.v1.Sampling", "strata.v1.Models", "strata.v1.Jobs"}) {
    state->server->GetHealthCheckService()->SetServingStatus(name, true);
  }
  return std::unique_ptr<RpcServer>(new RpcServer(std::move(state)));
}

std::uint16_t RpcServer::port() const { return static_cast<std::uint16_t>(state_->port); }

void RpcServer::StopServing() { state_->server->GetHealthCheckService()->SetServingStatus(false); }

void RpcServer::Close(std::chrono::system_clock::time_point deadline) {
  state_->server->Shutdown(deadline);
  state_->server->Wait();
}

}  // namespace strata::server
