#include "server/http/http_server.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <condition_variable>
#include <mutex>
#include <set>
#include <string_view>
#include <system_error>
#include <thread>
#include <utility>

#include "server/listen.h"
#include "server/service/log.h"

namespace strata::server {
namespace {

/// How long the acceptor leaves waiting clients alone while no descriptor is free.
constexpr int kDescriptorWaitMs = 20;

/// For a connection that no thread is left for. One write, which a fresh socket always takes.
void TurnAway(int socket, bool plain) {
  constexpr std::string_view kBusy =
      "HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nConnection: close\r\n"
      "Content-Type: application/problem+json\r\nContent-Length: 117\r\n\r\n"
      R"({"type":"/problems/unavailable","title":"the service cannot take this now","status":503,"detail":"too many connections"})";
  if (plain)
    static_cast<void>(send(socket, kBusy.data(), kBusy.size(), MSG_NOSIGNAL | MSG_DONTWAIT));
  close(socket);
}

}  // namespace

struct HttpServer::State {
  State(Options chosen, Service& service, io::Fd listening, int stop_event)
      : options(std::move(chosen)),
        listener(std::move(listening)),
        shared{service, options.limits, stop_event, options.guard} {}
  ~State() { close(shared.stop); }

  void Accept() {
    std::array<pollfd, 2> waited = {{{listener.get(), POLLIN, 0}, {shared.stop, POLLIN, 0}}};
    while (true) {
      if (poll(waited.data(), waited.size(), -1) < 0 && errno != EINTR) return;
      if (waited[1].revents != 0) return;
      const int socket = accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC);
      if (socket >= 0) Serve(socket);
      // Out of descriptors: the ones that end give theirs back.
      const bool none_left = socket < 0 && (errno == EMFILE || errno == ENFILE);
      if (none_left && poll(&waited[1], 1, kDescriptorWaitMs) > 0) return;
    }
  }

  void Serve(int socket) {
    std::unique_lock lock(mutex);
    if (sockets.size() >= options.limits.connections) {
      lock.unlock();
      return TurnAway(socket, !options.tls);
    }
    sockets.insert(socket);
    lock.unlock();
    shared.service.metrics().AddConnections("http", 1);
    try {
      std::thread([this, socket] { Run(socket); }).detach();
    } catch (const std::system_error& error) {
      Log(LogLevel::kError, "no_thread", {{"reason", error.what()}});
      TurnAway(dup(socket), !options.tls);
      Forget(socket, nullptr);
    }
  }

  void Run(int socket) {
    auto transport = options.tls ? options.tls->Wrap(socket) : PlainTransport(socket);
    ServeConnection(shared, *transport);
    Forget(socket, std::move(transport));
  }

  /// Closes the socket only once its number is out of the set, so that Close breaks no other's.
  void Forget(int socket, std::unique_ptr<Transport> transport) {
    shared.service.metrics().AddConnections("http", -1);
    const std::lock_guard lock(mutex);
    sockets.erase(socket);
    if (!transport) close(socket);
    transport.reset();
    ended.notify_all();
  }

  const Options options;
  io::Fd listener;
  const HttpShared shared;
  std::mutex mutex;
  std::condition_variable ended;
  std::set<int> sockets;
  std::thread acceptor;
};

HttpServer::HttpServer(std::unique_ptr<State> state) : state_(std::move(state)) {
  state_->acceptor = std::thread([this] { state_->Accept(); });
}

HttpServer::~HttpServer() { Close(); }

Result<std::unique_ptr<HttpServer>> HttpServer::Start(Options options, Service& service) {
  auto listener = Listen(options.address, options.port);
  if (!listener) return Forward(listener);
  const int stop = eventfd(0, EFD_CLOEXEC);
  return std::unique_ptr<HttpServer>(new HttpServer(
      std::make_unique<State>(std::move(options), service, *std::move(listener), stop)));
}

std::uint16_t HttpServer::port() const { return PortOf(state_->listener.get()); }

void HttpServer::StopAccepting() {
  if (!state_->acceptor.joinable()) return;
  eventfd_write(state_->shared.stop, 1);
  state_->acceptor.join();
  state_->listener.Close();  // Now the system refuses who comes.
}

void HttpServer::Close() {
  StopAccepting();
  std::unique_lock lock(state_->mutex);
  for (const int socket : state_->sockets) shutdown(socket, SHUT_RDWR);
  state_->ended.wait(lock, [this] { return state_->sockets.empty(); });
}

}  // namespace strata::server
