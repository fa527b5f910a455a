#include "server/serve_command.h"

#include <signal.h>
#include <sys/resource.h>

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

#include "core/version.h"
#include "server/http/http_server.h"
#include "server/remote/s3_config.h"
#include "server/resources.h"
#include "server/rpc/rpc_server.h"
#include "server/serve_config.h"
#include "server/service/stored_service.h"
#include "server/systemd_notify.h"

namespace strata::server {
namespace {

Result<std::string> ReadWhole(const std::string& path) {
  if (path.empty()) return std::string();
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf()))
    return Fail(ErrorCode::kNotFound, path + ": cannot be read");
  return text.str();
}

Result<std::unique_ptr<HttpServer>> StartHttp(const ServeCommand& command, Service& service) {
  if (!command.http) return std::unique_ptr<HttpServer>();
  HttpServer::Options options;
  options.address = command.http->address;
  options.port = command.http->port;
  options.limits = command.http_limits;
  // Another site's page does not know a key, but a browser shows its certificate to whoever asks.
  const bool keys = !command.keys.empty(), worker = command.mode == ServeMode::kWorker;
  options.guard =
      BrowserGuard({.refuse_other_sites = !keys,
                    .refuse_other_hosts = !keys && !worker && command.tls.client_ca.empty(),
                    .address = command.http->address,
                    .names = command.allowed_hosts});
  if (command.tls.on()) {
    auto tls = TlsContext::Load(command.tls);
    if (!tls) return Forward(tls);
    options.tls = *std::move(tls);
  }
  return HttpServer::Start(std::move(options), service);
}

Result<std::unique_ptr<RpcServer>> StartRpc(const ServeCommand& command, Service& service) {
  if (!command.grpc) return std::unique_ptr<RpcServer>();
  if (command.tls.on()) {
    // gRPC takes files that do not fit together, and then fails every handshake.
    if (auto fits = TlsContext::Load(command.tls); !fits) return Forward(fits);
  }
  RpcServer::Options options;
  options.address = command.grpc->address;
  options.port = command.grpc->port;
  options.connections = command.http_limits.connections;
  options.header_bytes = command.http_limits.header_bytes;
  options.header_seconds = command.http_limits.header_seconds;
  options.idle_seconds = command.http_limits.idle_seconds;
  options.bytes_per_second = command.http_limits.bytes_per_second;
  options.grace_seconds = command.http_limits.grace_seconds;
  for (const auto& [path, text] : {std::pair{&command.tls.certificate, &options.certificate},
                                   std::pair{&command.tls.key, &options.key},
                                   std::pair{&command.tls.client_ca, &options.client_ca}}) {
    auto read = ReadWhole(*path);
    if (!read) return Forward(read);
    *text = *std::move(read);
  }
  return RpcServer::Start(options, service);
}

Result<std::unique_ptr<Service>> MakeService(const ServeCommand& command, Metrics& metrics) {
  ApiKeys keys;
  if (!command.keys.empty()) {
    auto loaded = ApiKeys::Load(command.keys);
    if (!loaded) return Forward(loaded);
    keys = *std::move(loaded);
  }
  auto scratch = OpenScratch(command.scratch);
  if (!scratch) return Forward(scratch);
  if (!*scratch) return Fail(ErrorCode::kNotFound, "no scratch directory: name one with --scratch");
  return std::make_unique<Service>(command.limits, std::move(keys), *std::move(scratch), metrics);
}

/// Blocks them in this thread and all it starts, so that only AwaitEnd sees them.
sigset_t BlockEndSignals() {
  sigset_t set;
  sigemptyset(&set);
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&set, number);
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
  signal(SIGPIPE, SIG_IGN);
  return set;
}

/// Many clients are many descriptors: as many as the system lets this process open.
void RaiseOpenFiles() {
  rlimit files{};
  if (getrlimit(RLIMIT_NOFILE, &files) != 0) return;
  files.rlim_cur = files.rlim_max;
  static_cast<void>(setrlimit(RLIMIT_NOFILE, &files));
}

std::string Where(const std::optional<Listen>& listen, std::uint64_t port) {
  return listen ? listen->address + ':' + std::to_string(port) : "off";
}

/// Everything that runs. Order matters: the service outlives what calls it.
struct Running {
  Metrics metrics;
  std::unique_ptr<Service> service;
  std::unique_ptr<StoredService> stored;
  std::unique_ptr<BatchService> batches;
  std::unique_ptr<HttpServer> http;
  std::unique_ptr<RpcServer> rpc;
};

/// Until no request is in flight, a second signal comes, or the time is up; then jobs end as if
/// their clients had gone.
void Drain(Running& running, const sigset_t& signals, const ServeCommand& command) {
  const bool worker = command.mode == ServeMode::kWorker;
  Log(LogLevel::kInfo, "draining",
      {{"requests", std::uint64_t{running.service->requests_in_flight()}}});
  NotifySystemd("STOPPING=1");
  running.service->Drain();
  if (running.stored) running.stored->StopClaiming();
  if (running.rpc) running.rpc->StopServing();
  if (running.http) running.http->StopAccepting();
  const auto deadline = SteadyClock::now() + std::chrono::seconds(command.drain_seconds);
  constexpr timespec kTick = {0, 50'000'000};
  const auto busy = [&running, worker] {
    // What a worker has begun it finishes; of a service's jobs others wait for requests only.
    return running.service->requests_in_flight() > 0 || (worker && running.stored->running() > 0);
  };
  while (busy() && SteadyClock::now() < deadline) {
    if (sigtimedwait(&signals, nullptr, &kTick) > 0) break;
  }
  const std::uint64_t left = running.service->requests_in_flight();
  running.service->CancelJobs();
  if (running.http) running.http->Close();
  // What is left hears that it is cancelled; a handler notices within a tick.
  if (running.rpc) running.rpc->Close(std::chrono::system_clock::now() + std::chrono::seconds(1));
  Log(LogLevel::kInfo, "stopped", {{"requests_cut", left}});
}

Result<void> RunNode(std::span<const std::string> arguments, ServeMode mode) {
  const auto parsed = ParseServe(arguments, mode);
  if (!parsed) return Forward(parsed);
  if (const auto* const show = std::get_if<ShowText>(&*parsed)) {
    std::fputs(show->text.c_str(), stdout);
    return {};
  }
  const auto& command = std::get<ServeCommand>(*parsed);
  // Read by now; the processes that are started need none of them.
  if (command.store && command.store->bucket) ForgetCredentialVariables();
  const sigset_t signals = BlockEndSignals();
  RaiseOpenFiles();
  StartLog(command.log_format, command.log_level);
  Running running;
  auto service = MakeService(command, running.metrics);
  if (!service) return Forward(service);
  running.service = *std::move(service);
  if (command.store) {
    auto stored = StoredService::Start(*command.store, *running.service);
    if (!stored) return Forward(stored);
    running.stored = *std::move(stored);
    running.service->SetStored(running.stored.get());
    if (mode == ServeMode::kWorker) running.service->AnswerProbesAlone();
  }
  if (command.batches) {
    auto batches = BatchService::Start(*command.batches, *running.service, running.stored->store());
    // Beside another process on the same folder this one serves all else.
    const bool others = !batches && batches.error().code == ErrorCode::kConflict;
    if (!batches && !others) return Forward(batches);
    if (others) Log(LogLevel::kWarning, "no batches", {{"reason", batches.error().message}});
    if (batches) running.batches = *std::move(batches);
    running.service->SetBatches(running.batches.get());
  }
  auto http = StartHttp(command, *running.service);
  if (!http) return Forward(http);
  running.http = *std::move(http);
  auto rpc = StartRpc(command, *running.service);
  if (!rpc) return Forward(rpc);
  running.rpc = *std::move(rpc);
  Log(LogLevel::kInfo, mode == ServeMode::kWorker ? "working" : "serving",
      {{"version", std::string(kVersion)},
       {"http", Where(command.http, running.http ? running.http->port() : 0)},
       {"grpc", Where(command.grpc, running.rpc ? running.rpc->port() : 0)},
       {"tls", command.tls.on() ? "on" : "off"},
       {"data", command.store ? command.store->data : "none"},
       {"blobs", command.store && command.store->bucket ? "bucket" : "data"},
       {"database", command.store && command.store->shared ? "postgresql" : "sqlite"},
       {"keys", command.keys.empty() ? "none" : "file"},
       {"jobs", std::uint64_t{command.limits.jobs.jobs}},
       {"job_memory", command.limits.job_memory_bytes}});
  NotifySystemd("READY=1");
  int received = 0;
  sigwait(&signals, &received);
  Drain(running, signals, command);
  return {};
}

}  // namespace

Result<void> RunServe(std::span<const std::string> arguments) {
  return RunNode(arguments, ServeMode::kServe);
}

Result<void> RunWorkerNode(std::span<const std::string> arguments) {
  return RunNode(arguments, ServeMode::kWorker);
}

}  // namespace strata::server
