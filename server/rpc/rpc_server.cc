#include "server/rpc/rpc_server.h"

#include <grpc/support/log.h>
#include <grpcpp/ext/proto_server_reflection_plugin.h>
#include <grpcpp/grpcpp.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/resource_quota.h>
#include <grpcpp/support/server_interceptor.h>

#include <algorithm>
#include <string_view>
#include <utility>
#include <vector>

#include "server/listen.h"
#include "server/rpc/batch_rpc.h"
#include "server/rpc/call_watch.h"
#include "server/rpc/rpc_door.h"
#include "server/rpc/sampling_rpc.h"
#include "server/rpc/stored_rpc.h"
#include "server/service/log.h"

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

/// gRPC's own lines go where the others go, in their format.
void TakeLog(gpr_log_func_args* line) {
  const LogLevel level =
      line->severity == GPR_LOG_SEVERITY_ERROR ? LogLevel::kWarning : LogLevel::kDebug;
  Log(level, "grpc", {{"reason", std::string(line->message)}});
}

// Calls of one connection at a time. One whose message never comes costs some 13 KB until its
// connection ends.
constexpr int kMostStreams = 100;

int Millis(std::uint32_t seconds) { return static_cast<int>(seconds * 1000); }

void Bound(grpc::ServerBuilder& builder, const RpcServer::Options& options,
           std::uint32_t requests) {
  builder.SetMaxReceiveMessageSize(kMostMessage);
  builder.AddChannelArgument(GRPC_ARG_MAX_METADATA_SIZE, static_cast<int>(options.header_bytes));
  builder.AddChannelArgument(GRPC_ARG_MAX_CONCURRENT_STREAMS,
                             std::min<int>(kMostStreams, requests));
  builder.AddChannelArgument(GRPC_ARG_SERVER_HANDSHAKE_TIMEOUT_MS, Millis(options.header_seconds));
  builder.AddChannelArgument(GRPC_ARG_MAX_CONNECTION_IDLE_MS, Millis(options.idle_seconds));
  // A client that is gone without a word is found out.
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIME_MS, 60'000);
  builder.AddChannelArgument(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 20'000);
  grpc::ResourceQuota quota("strata");
  // Each call has a thread; some more, so that those over the limit hear so.
  quota.SetMaxThreads(static_cast<int>(requests) + 32);
  builder.SetResourceQuota(quota);
}

/// Ends a call that the service's own code does not see: a stream of reflection holds a thread for
/// as long as its client likes.
class ReflectionBound : public grpc::experimental::ServerInterceptorFactoryInterface {
 public:
  explicit ReflectionBound(CallWatch& watch) : watch_(watch) {}

  /// Null: the call has none.
  grpc::experimental::Interceptor* CreateServerInterceptor(
      grpc::experimental::ServerRpcInfo* call) override {
    const bool reflection = std::string_view(call->method()).starts_with("/grpc.reflection.");
    return reflection ? new Watched(watch_, *call->server_context()) : nullptr;
  }

 private:
  class Watched : public grpc::experimental::Interceptor {
   public:
    Watched(CallWatch& watch, grpc::ServerContextBase& context) : transfer_(watch, context) {}
    void Intercept(grpc::experimental::InterceptorBatchMethods* batch) override {
      batch->Proceed();
    }

   private:
    CallWatch::Transfer transfer_;
  };

  CallWatch& watch_;
};

}  // namespace

struct RpcServer::State {
  State(const Options& options, Service& service, io::Fd listener)
      : port(PortOf(listener.get())),
        watch({options.bytes_per_second, std::chrono::seconds(options.grace_seconds)}),
        sampling(service, watch),
        models(service, watch),
        jobs(service, watch),
        batches(service, watch),
        door({std::move(listener), options.connections}, service.metrics()) {}

  const std::uint16_t port;
  CallWatch watch;
  SamplingRpc sampling;
  ModelsRpc models;
  JobsRpc jobs;
  BatchesRpc batches;
  RpcDoor door;
  std::unique_ptr<grpc::Server> server;
};

RpcServer::RpcServer(std::unique_ptr<State> state) : state_(std::move(state)) {}
RpcServer::~RpcServer() { Close(std::chrono::system_clock::now()); }

Result<std::unique_ptr<RpcServer>> RpcServer::Start(const Options& options, Service& service) {
  auto listener = Listen(options.address, options.port);
  if (!listener) return Forward(listener);
  gpr_set_log_function(TakeLog);
  grpc::EnableDefaultHealthCheckService(true);
  grpc::reflection::InitProtoReflectionServerBuilderPlugin();
  auto state = std::make_unique<State>(options, service, *std::move(listener));
  grpc::ServerBuilder builder;
  Bound(builder, options, service.limits().requests);
  std::vector<std::unique_ptr<grpc::experimental::ServerInterceptorFactoryInterface>> interceptors;
  interceptors.push_back(std::make_unique<ReflectionBound>(state->watch));
  builder.experimental().SetInterceptorCreators(std::move(interceptors));
  auto acceptor = builder.experimental().AddExternalConnectionAcceptor(
      grpc::ServerBuilder::experimental_type::ExternalConnectionType::FROM_FD,
      CredentialsOf(options));
  builder.RegisterService(&state->sampling);
  builder.RegisterService(&state->models);
  builder.RegisterService(&state->jobs);
  builder.RegisterService(&state->batches);
  state->server = builder.BuildAndStart();
  if (!state->server) {
    return Fail(ErrorCode::kIo, "cannot serve gRPC: the certificate and key do not fit");
  }
  for (const char* const name :
       {"strata.v1.Sampling", "strata.v1.Models", "strata.v1.Jobs", "strata.v1.Batches"}) {
    state->server->GetHealthCheckService()->SetServingStatus(name, true);
  }
  if (auto open = state->door.Start(std::move(acceptor)); !open) return Forward(open);
  return std::unique_ptr<RpcServer>(new RpcServer(std::move(state)));
}

std::uint16_t RpcServer::port() const { return state_->port; }

void RpcServer::StopServing() { state_->server->GetHealthCheckService()->SetServingStatus(false); }

void RpcServer::Close(std::chrono::system_clock::time_point deadline) {
  state_->door.Close();
  state_->server->Shutdown(deadline);
  state_->server->Wait();
}

}  // namespace strata::server
