#include "server/http/http_server.h"

#include <arpa/inet.h>
#include <netinet/in.h>
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

#include "io/output_place.h"
#include "server/service/log.h"

namespace strata::server {
namespace {

constexpr int kBacklog = 512;

struct Address {
  sockaddr_storage storage{};
  socklen_t size = 0;
};

Result<Address> ParseAddress(const std::string& text, std::uint16_t port) {
  Address address;
  auto& v4 = reinterpret_cast<sockaddr_in&>(address.storage);
  auto& v6 = reinterpret_cast<sockaddr_in6&>(address.storage);
  if (inet_pton(AF_INET, text.c_str(), &v4.sin_addr) == 1) {
    v4.sin_family = AF_INET;
    v4.sin_port = htons(port);
    address.size = sizeof v4;
  } else if (inet_pton(AF_INET6, text.c_str(), &v6.sin6_addr) == 1) {
    v6.sin6_family = AF_INET6;
    v6.sin6_port = htons(port);
    address.size = sizeof v6;
  } else {
    return Fail(ErrorCode::kInvalidArgument,
                "found '" + text + "', expected an IPv4 or IPv6 address");
  }
  return address;
}

Result<int> Listen(const std::string& text, std::uint16_t port) {
  const auto address = ParseAddress(text, port);
  if (!address) return Forward(address);
  const int fd = socket(address->storage.ss_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const int on = 1;
  if (fd >= 0 && setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
      bind(fd, reinterpret_cast<const sockaddr*>(&address->storage), address->size) == 0 &&
      listen(fd, kBacklog) == 0) {
    return fd;
  }
  const int error = errno;
  if (fd >= 0) close(fd);
  return Fail(ErrorCode::kIo, "cannot listen on " + text + " port " + std::to_string(port) + ": " +
                                  io::SystemReason(error));
}

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
  State(Options chosen, Service& service, int listening, int stop_event)
      : options(std::move(chosen)),
        listener(listening),
        shared{service, options.limits, stop_event, options.guard} {}
  ~State() { close(shared.stop); }

  void Accept() {
    std::array<pollfd, 2> waited = {{{listener, POLLIN, 0}, {shared.stop, POLLIN, 0}}};
    while (true) {
      if (poll(waited.data(), waited.size(), -1) < 0 && errno != EINTR) return;
      if (waited[1].revents != 0) return;
      const int socket = accept4(listener, nullptr, nullptr, SOCK_CLOEXEC);
      if (socket >= 0) Serve(socket);
      // Out of descriptors: the ones that end give theirs back.
      if (socket < 0 && (errno == EMFILE || errno == ENFILE)) std::this_thread::yield();
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
  const int listener;
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
  const auto listener = Listen(options.address, options.port);
  if (!listener) return Forward(listener);
  const int stop = eventfd(0, EFD_CLOEXEC);
  return std::unique_ptr<HttpServer>(
      new HttpServer(std::make_unique<State>(std::move(options), service, *listener, stop)));
}

std::uint16_t HttpServer::port() const {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  getsockname(state_->listener, reinterpret_cast<sockaddr*>(&address), &size);
  return ntohs(address.ss_family == AF_INET6 ? reinterpret_cast<sockaddr_in6&>(address).sin6_port
                                             : reinterpret_cast<sockaddr_in&>(address).sin_port);
}

void HttpServer::StopAccepting() {
  if (!state_->acceptor.joinable()) return;
  eventfd_write(state_->shared.stop, 1);
  state_->acceptor.join();
  close(state_->listener);  // Now the system refuses who comes.
}

void HttpServer::Close() {
  StopAccepting();
  std::unique_lock lock(state_->mutex);
  for (const int socket : state_->sockets) shutdown(socket, SHUT_RDWR);
  state_->ended.wait(lock, [this] { return state_->sockets.empty(); });
}

}  // namespace strata::server
