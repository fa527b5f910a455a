#include "server/http/transport.h"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/error.hpp>
#include <cerrno>

#include "server/http/socket_stream.h"

namespace strata::server {
namespace {

using boost::system::error_code;

/// Milliseconds until `deadline` for poll, at most an hour, rounded up.
int PollTime(SteadyClock::time_point deadline) {
  if (deadline == SteadyClock::time_point::max()) return -1;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - SteadyClock::now());
  return static_cast<int>(std::clamp<std::int64_t>(left.count(), 0, 3'600'000));
}

class Plain final : public Transport {
 public:
  explicit Plain(int socket) : stream_(socket) {}
  std::size_t ReadSome(void* into, std::size_t size, error_code& error) override {
    return stream_.Read(into, size, error);
  }
  std::size_t WriteSome(const void* from, std::size_t size, error_code& error) override {
    return stream_.Write(from, size, error);
  }
  void Handshake(error_code& error) override { error = {}; }
  void FinishWriting() override { shutdown(stream_.descriptor(), SHUT_WR); }
  void SetDeadline(SteadyClock::time_point deadline) override { stream_.SetDeadline(deadline); }
  void SetStop(int stop) override { stream_.SetStop(stop); }
  int descriptor() const override { return stream_.descriptor(); }

 private:
  SocketStream stream_;
};

}  // namespace

SocketStream::SocketStream(int socket) : socket_(socket) {
  fcntl(socket_, F_SETFL, fcntl(socket_, F_GETFL) | O_NONBLOCK);
  const int on = 1;
  setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
}

SocketStream::~SocketStream() { close(socket_); }

SocketStream::executor_type SocketStream::get_executor() {
  static boost::asio::io_context context;
  return context.get_executor();
}

bool SocketStream::Wait(short events, error_code& error) const {
  std::array<pollfd, 2> waited = {{{socket_, events, 0}, {stop_, POLLIN, 0}}};  // -1 is skipped.
  const int ready = poll(waited.data(), waited.size(), PollTime(deadline_));
  if (ready < 0 && errno != EINTR) error = error_code(errno, boost::system::system_category());
  if (ready == 0) error = boost::asio::error::timed_out;
  if (ready > 0 && waited[0].revents == 0) error = boost::asio::error::operation_aborted;
  return !error;
}

std::size_t SocketStream::Read(void* into, std::size_t size, error_code& error) {
  error = {};
  if (size == 0) return 0;
  while (true) {
    const ssize_t n = recv(socket_, into, size, 0);
    if (n > 0) return static_cast<std::size_t>(n);
    if (n == 0) error = boost::asio::error::eof;
    if (n == 0) return 0;
    const bool again = errno == EAGAIN || errno == EINTR;
    if (!again) error = error_code(errno, boost::system::system_category());
    if (!again || !Wait(POLLIN, error)) return 0;
  }
}

std::size_t SocketStream::Write(const void* from, std::size_t size, error_code& error) {
  error = {};
  while (size > 0) {
    const ssize_t n = send(socket_, from, size, MSG_NOSIGNAL);
    if (n >= 0) return static_cast<std::size_t>(n);
    const bool again = errno == EAGAIN || errno == EINTR;
    if (!again) error = error_code(errno, boost::system::system_category());
    if (!again || !Wait(POLLOUT, error)) return 0;
  }
  return 0;
}

bool PeerIsGone(int socket) {
  pollfd waited = {socket, POLLRDHUP, 0};
  return poll(&waited, 1, 0) > 0;
}

std::unique_ptr<Transport> PlainTransport(int socket) { return std::make_unique<Plain>(socket); }

}  // namespace strata::server
