#include "server/http/connection.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <boost/asio/error.hpp>
#include <boost/beast/http/read.hpp>
#include <cerrno>
#include <cstdint>
#include <exception>
#include <iterator>
#include <string>

#include "server/http/framing.h"
#include "server/http/http_exchange.h"
#include "server/http/router.h"
#include "server/service/log.h"
#include "server/service/request_id.h"

namespace strata::server {
namespace {

namespace http = boost::beast::http;
using boost::system::error_code;

std::string PeerOf(int socket) {
  sockaddr_storage address{};
  socklen_t size = sizeof address;
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (getpeername(socket, reinterpret_cast<sockaddr*>(&address), &size) != 0) return "unknown";
  const void* const bytes =
      address.ss_family == AF_INET6
          ? static_cast<const void*>(&reinterpret_cast<const sockaddr_in6&>(address).sin6_addr)
          : &reinterpret_cast<const sockaddr_in&>(address).sin_addr;
  return inet_ntop(address.ss_family, bytes, text.data(), text.size()) ? text.data() : "unknown";
}

Problem ProblemOfHeader(const error_code& error, const HttpLimits& limits) {
  if (error == http::error::header_limit) {
    return ProblemOf(
        Refusal::kHeaderTooLarge,
        "the header is larger than the " + std::to_string(limits.header_bytes) + " bytes allowed");
  }
  if (error == boost::asio::error::timed_out) {
    return ProblemOf(Refusal::kTooSlow, "the header did not arrive within " +
                                            std::to_string(limits.header_seconds) + " seconds");
  }
  return ProblemOf(Refusal::kMalformed, "the request's header: " + error.message());
}

class Connection {
 public:
  Connection(const HttpShared& shared, Transport& transport)
      : shared_(shared),
        transport_(transport),
        peer_(PeerOf(transport.descriptor())),
        buffer_(shared.limits.header_bytes + kBodyPiece) {}

  void Run() {
    error_code error;
    transport_.SetDeadline(HeaderDeadline());
    transport_.Handshake(error);
    if (error) {
      return Log(LogLevel::kDebug, "handshake_failed",
                 {{"peer", peer_}, {"reason", error.message()}});
    }
    while (AwaitRequest() && ServeOne()) {
    }
    Linger();
  }

 private:
  SteadyClock::time_point HeaderDeadline() const {
    return SteadyClock::now() + std::chrono::seconds(shared_.limits.header_seconds);
  }

  /// Reads the first bytes of a request. Only here does `stop` end the waiting.
  bool AwaitRequest() {
    if (buffer_.size() > 0) return true;
    const auto space = buffer_.prepare(4096);
    transport_.SetDeadline(SteadyClock::now() + std::chrono::seconds(shared_.limits.idle_seconds));
    transport_.SetStop(shared_.stop);
    error_code error;
    buffer_.commit(transport_.ReadSome(space.data(), space.size(), error));
    transport_.SetStop(-1);
    return !error;
  }

  /// Whether another may follow.
  bool ServeOne() {
    start_ = SteadyClock::now();
    RequestParser parser;
    parser.header_limit(shared_.limits.header_bytes);
    parser.body_limit(UINT64_MAX);  // Each endpoint has its own.
    transport_.SetDeadline(HeaderDeadline());
    error_code error;
    BeastStream stream(transport_);
    http::read_header(stream, buffer_, parser, error);
    const bool nothing_came = error == http::error::end_of_stream ||
                              (error && error != boost::asio::error::timed_out &&
                               error.category() == boost::system::system_category());
    if (nothing_came) return false;
    HttpExchange exchange(shared_, transport_, buffer_, parser);
    const Routed routed = error ? RefuseHeader(exchange, ProblemOfHeader(error, shared_.limits))
                                : Answer(exchange, parser);
    Note(exchange, routed);
    return !error && exchange.reusable();
  }

  static Routed RefuseHeader(HttpExchange& exchange, const Problem& problem) {
    exchange.CloseAfterwards();
    exchange.RespondProblem(problem);
    return {};
  }

  Routed Answer(HttpExchange& exchange, const RequestParser& parser) {
    if (auto framed = CheckFraming(parser); !framed) {
      return RefuseHeader(exchange, framed.error());
    }
    const auto& fields = parser.get().base();
    const auto count = static_cast<std::size_t>(std::distance(fields.begin(), fields.end()));
    if (count > shared_.limits.header_fields) {
      return RefuseHeader(exchange, ProblemOf(Refusal::kHeaderTooLarge,
                                              "found " + std::to_string(count) +
                                                  " header fields, expected at most " +
                                                  std::to_string(shared_.limits.header_fields)));
    }
    const auto text = parser.get().target();
    auto target = ParseTarget({text.data(), text.size()});
    if (!target) return RefuseHeader(exchange, target.error());
    exchange.SetTarget(*std::move(target));
    if (const auto from_here = shared_.guard.Check(exchange); !from_here) {
      exchange.RespondProblem(from_here.error());
      return {};
    }
    return Dispatch(shared_.service, exchange);
  }

  void Note(const HttpExchange& exchange, const Routed& routed) const {
    const double seconds = std::chrono::duration<double>(SteadyClock::now() - start_).count();
    shared_.service.metrics().Count({"http", routed.endpoint, exchange.status(), seconds,
                                     exchange.bytes_in(), exchange.bytes_out()});
    Log(LogLevel::kInfo, "request",
        {{"protocol", "http"},
         {"request_id", exchange.request_id()},
         {"method", std::string(exchange.method())},
         {"path", exchange.target().path},
         {"status", static_cast<std::uint64_t>(exchange.status())},
         {"seconds", seconds},
         {"bytes_in", exchange.bytes_in()},
         {"bytes_out", exchange.bytes_out()},
         {"peer", peer_},
         {"caller", routed.caller},
         {"traceparent", TraceParentOf(exchange.header("traceparent"))}});
  }

  /// Reads on a little after the last answer: closing a socket that holds unread bytes resets the
  /// connection, and the client would lose the answer that says why.
  void Linger() {
    transport_.SetDeadline(SteadyClock::now() + std::chrono::seconds(1));
    transport_.FinishWriting();
    const auto deadline = SteadyClock::now() + std::chrono::seconds(2);
    pollfd waited = {transport_.descriptor(), POLLIN, 0};
    std::array<char, 16384> scrap;
    for (std::size_t read = 0; read < (std::size_t{16} << 20) && SteadyClock::now() < deadline;) {
      if (poll(&waited, 1, 100) < 0) return;
      const ssize_t n = recv(waited.fd, scrap.data(), scrap.size(), MSG_DONTWAIT);
      if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) return;
      read += n > 0 ? static_cast<std::size_t>(n) : 0;
    }
  }

  const HttpShared& shared_;
  Transport& transport_;
  const std::string peer_;
  /// Bounded: a body's pieces do not stay in it, but the lines between chunks and after the last
  /// are gathered whole before the parser looks at them.
  boost::beast::flat_buffer buffer_;
  SteadyClock::time_point start_;
};

}  // namespace

void ServeConnection(const HttpShared& shared, Transport& transport) {
  try {
    Connection(shared, transport).Run();
  } catch (const std::exception& error) {
    Log(LogLevel::kError, "connection_failed", {{"reason", error.what()}});
  }
}

}  // namespace strata::server
