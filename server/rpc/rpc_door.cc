#include "server/rpc/rpc_door.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <utility>

#include "io/output_place.h"

namespace strata::server {
namespace {

/// How long waiting clients are left alone while no descriptor is free.
constexpr int kDescriptorWaitMs = 20;

bool Watch(int events, int descriptor, std::uint32_t what) {
  epoll_event event{};
  event.events = what;
  event.data.fd = descriptor;
  return epoll_ctl(events, EPOLL_CTL_ADD, descriptor, &event) == 0;
}

}  // namespace

RpcDoor::RpcDoor(Options options, Metrics& metrics)
    : options_(std::move(options)), metrics_(metrics) {}

RpcDoor::~RpcDoor() {
  Close();
  while (!watched_.empty()) Forget(*watched_.begin());
}

Result<void> RpcDoor::Start(std::unique_ptr<Acceptor> acceptor) {
  acceptor_ = std::move(acceptor);
  events_ = io::Fd(epoll_create1(EPOLL_CLOEXEC));
  stop_ = io::Fd(eventfd(0, EFD_CLOEXEC));
  if (!events_ || !stop_ || !Watch(events_.get(), options_.listener.get(), EPOLLIN) ||
      !Watch(events_.get(), stop_.get(), EPOLLIN)) {
    return Fail(ErrorCode::kIo, "cannot wait for connections: " + io::SystemReason(errno));
  }
  thread_ = std::thread([this] { Run(); });
  return {};
}

void RpcDoor::Close() {
  if (!thread_.joinable()) return;
  eventfd_write(stop_.get(), 1);
  thread_.join();
}

void RpcDoor::Run() {
  std::array<epoll_event, 64> happened;
  while (true) {
    const int count = epoll_wait(events_.get(), happened.data(), happened.size(), -1);
    if (count < 0 && errno != EINTR) return;
    for (int i = 0; i < count; ++i) {
      const int descriptor = happened[static_cast<std::size_t>(i)].data.fd;
      if (descriptor == stop_.get()) return;
      if (descriptor == options_.listener.get()) {
        AcceptOne();
      } else {
        Forget(descriptor);
      }
    }
  }
}

void RpcDoor::AcceptOne() {
  io::Fd socket(accept4(options_.listener.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (!socket) {
    // Out of descriptors: the ones that end give theirs back.
    pollfd stop = {stop_.get(), POLLIN, 0};
    if (errno == EMFILE || errno == ENFILE) poll(&stop, 1, kDescriptorWaitMs);
    return;
  }
  // Closed without a word: to a client that has heard HTTP/2's hello, a goodbye is a reason to come
  // again at once; without one it waits longer each time, and its calls fail as UNAVAILABLE.
  if (watched_.size() < options_.most) HandOver(std::move(socket));
}

/// gRPC does not say when it closes a connection, but it shuts it down first, which a second
/// descriptor of the same socket sees.
void RpcDoor::HandOver(io::Fd socket) {
  io::Fd second(fcntl(socket.get(), F_DUPFD_CLOEXEC, 0));
  if (!second || !Watch(events_.get(), second.get(), 0)) return;
  const int on = 1;
  static_cast<void>(setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on));
  watched_.insert(second.Release());
  metrics_.AddConnections("grpc", 1);
  Acceptor::NewConnectionParameters connection;
  connection.listener_fd = options_.listener.get();
  connection.fd = socket.Release();
  acceptor_->HandleNewConnection(&connection);
}

void RpcDoor::Forget(int watched) {
  epoll_ctl(events_.get(), EPOLL_CTL_DEL, watched, nullptr);
  watched_.erase(watched);
  close(watched);
  metrics_.AddConnections("grpc", -1);
}

}  // namespace strata::server
