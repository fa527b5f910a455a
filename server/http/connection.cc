#include "server/http/connection.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <array>
#include <boost/asio/error.hpp>
#include <boost/beast/http/read.hpp>
#include <cstdint>
#include <exception>
#include <iterator>
#include <string>

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
      : shared_(shared), transport_(transport), peer_(PeerOf(transport.descriptor())) {}

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
  Clock::time_point HeaderDeadline() const {
    return Clock::now() + std::chrono::seconds(shared_.limits.header_seconds);
  }

  bool AwaitRequest() {
    if (buffer_.size() > 0 || transport_.HasPending()) return true;
    const auto deadline = Clock::now() + std::chrono::seconds(shared_.limits.idle_seconds);
    return WaitReadable(transport_.descriptor(), shared_.stop, deadline);
  }

  /// Whether another may follow.
  bool ServeOne() {
    start_ = Clock::now();
    RequestParser parser;
    parser.header_limit(shared_.limits.header_bytes);
    parser.body_limit(UINT64_MAX);  // Each endpoint has its own.
    transport_.SetDeadline(HeaderDeadline());
    error_code error;
    BeastStream stream(transport_);
    http::read_header(stream, buffer_, parser, error);
    const bool nothing_came = error == http::error::end_of_stream ||
                              (error && error.category() == boost::system::system_category());
    if (nothing_came) return false;
    HttpExchange exchange(shared_, transport_, buffer_, parser);
    const Routed routed = error ? RefuseHeader(exchange, ProblemOfHeader(error, shared_.limits))
                                : Answer(exchange, parser);
    Note(exchange, routed);
    return !error && exchange.reusable();
  }

  static Routed RefuseHeader(HttpExchange& exchange, const Problem& problem) {
    exchange.RespondProblem(problem);
    return {};
  }

  Routed Answer(HttpExchange& exchange, const RequestParser& parser) {
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
    return Dispatch(shared_.service, exchange);
  }

  void Note(const HttpExchange& exchange, const Routed& routed) const {
    const double seconds = std::chrono::duration<double>(Clock::now() - start_).count();
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
    transport_.SetDeadline(Clock::now() + std::chrono::seconds(1));
    transport_.FinishWriting();
    const auto deadline = Clock::now() + std::chrono::seconds(2);
    std::array<char, 16384> scrap;
    for (std::size_t read = 0; read < (std::size_t{16} << 20) && Clock::now() < deadline;) {
      const ssize_t n =
          WaitReadable(transport_.descriptor(), shared_.stop, deadline)
              ? recv(transport_.descriptor(), scrap.data(), scrap.size(), MSG_DONTWAIT)
              : 0;
      if (n <= 0) return;
      read += static_cast<std::size_t>(n);
    }
  }

  const HttpShared& shared_;
  Transport& transport_;
  const std::string peer_;
  boost::beast::flat_buffer buffer_;
  Clock::time_point start_;
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
