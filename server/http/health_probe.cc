#include "server/http/health_probe.h"

#include <fcntl.h>
#include <netdb.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <array>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <cerrno>
#include <memory>
#include <utility>

#include "io/fd.h"
#include "io/output_place.h"
#include "server/http/socket_stream.h"

namespace strata::server {
namespace {

namespace ssl = boost::asio::ssl;
using boost::system::error_code;

/// Neither side of a probe has more to say than this, bytes.
constexpr std::size_t kMostHead = 4096;

/// "host:port", the host in brackets where it is an IPv6 address.
std::string Authority(const HealthUrl& url) {
  const bool brackets = url.host.find(':') != std::string::npos;
  return (brackets ? '[' + url.host + ']' : url.host) + ':' + url.port;
}

tl::unexpected<Error> Failed(const HealthUrl& url, const std::string& why) {
  return Fail(ErrorCode::kIo, Authority(url) + ": " + why);
}

/// A connected socket; -1 and errno of the last address tried.
io::Fd ConnectToAny(const addrinfo* address, timeval timeout) {
  for (; address; address = address->ai_next) {
    io::Fd tried(socket(address->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0));
    // Linux bounds connect() by it, too.
    setsockopt(tried.get(), SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
    if (connect(tried.get(), address->ai_addr, address->ai_addrlen) == 0) return tried;
  }
  return io::Fd(-1);
}

Result<io::Fd> Connect(const HealthUrl& url, std::chrono::seconds timeout) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int failed = getaddrinfo(url.host.c_str(), url.port.c_str(), &hints, &found)) {
    return Failed(url, gai_strerror(failed));
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> addresses(found, freeaddrinfo);
  io::Fd connected = ConnectToAny(found, {timeout.count(), 0});
  // EINPROGRESS is how Linux says that SO_SNDTIMEO is over.
  if (connected.get() < 0) {
    return Failed(url, errno == EINPROGRESS ? "no connection in time" : io::SystemReason(errno));
  }
  return connected;
}

/// Sends the request, returns the first line of what comes back.
template <class Stream>
std::string Exchange(Stream& stream, const HealthUrl& url, error_code& error) {
  const std::string request = "GET " + url.path + " HTTP/1.1\r\nHost: " + Authority(url) +
                              "\r\nUser-Agent: strata-health\r\nConnection: close\r\n\r\n";
  for (std::size_t sent = 0; sent < request.size() && !error;) {
    sent +=
        stream.write_some(boost::asio::buffer(request.data() + sent, request.size() - sent), error);
  }
  std::string head;
  std::array<char, 512> bytes;
  while (!error && head.find('\r') == std::string::npos && head.size() < kMostHead) {
    head.append(bytes.data(), stream.read_some(boost::asio::buffer(bytes), error));
  }
  return head.substr(0, head.find('\r'));
}

std::string ExchangeUnderTls(int socket, const HealthUrl& url, SteadyClock::time_point deadline,
                             error_code& error) {
  ssl::context context(ssl::context::tls_client);
  context.set_verify_mode(ssl::verify_none);
  ssl::stream<SocketStream> stream(socket, context);
  stream.next_layer().SetDeadline(deadline);
  stream.handshake(ssl::stream_base::client, error);
  return error ? std::string() : Exchange(stream, url, error);
}

std::string ExchangePlain(int socket, const HealthUrl& url, SteadyClock::time_point deadline,
                          error_code& error) {
  SocketStream stream(socket);
  stream.SetDeadline(deadline);
  return Exchange(stream, url, error);
}

}  // namespace

Result<HealthUrl> ParseHealthUrl(std::string_view text) {
  const std::string_view all = text;
  const auto invalid = [all] {
    return Fail(ErrorCode::kInvalidArgument,
                "found '" + std::string(all) +
                    "', expected http://HOST[:PORT][/PATH] or https://HOST[:PORT][/PATH]");
  };
  HealthUrl url;
  url.tls = text.starts_with("https://");
  if (!url.tls && !text.starts_with("http://")) return invalid();
  if (url.tls) url.port = "443";
  text.remove_prefix(url.tls ? 8 : 7);
  if (const auto slash = text.find('/'); slash != text.npos) {
    url.path = text.substr(slash);
    text = text.substr(0, slash);
  }
  const auto bracket = text.rfind(']');
  const auto colon = text.find(':', bracket == text.npos ? 0 : bracket);
  if (colon != text.npos) {
    url.port = text.substr(colon + 1);
    text = text.substr(0, colon);
  }
  if (text.starts_with('[') && text.ends_with(']')) text = text.substr(1, text.size() - 2);
  url.host = text;
  const bool digits = !url.port.empty() && url.port.size() <= 5 &&
                      url.port.find_first_not_of("0123456789") == std::string::npos;
  const bool clean = url.path.find_first_of(" \r\n\t") == std::string::npos &&
                     url.host.find_first_of(" \r\n\t@") == std::string::npos;
  if (url.host.empty() || !digits || !clean) return invalid();
  return url;
}

Result<void> ProbeHealth(const HealthUrl& url, std::chrono::seconds timeout) {
  const auto deadline = SteadyClock::now() + timeout;
  auto connected = Connect(url, timeout);
  if (!connected) return Forward(connected);
  error_code error;
  const auto exchange = url.tls ? ExchangeUnderTls : ExchangePlain;
  const std::string answer =
      exchange(fcntl(connected->get(), F_DUPFD_CLOEXEC, 0), url, deadline, error);
  if (answer.starts_with("HTTP/1.1 200")) return {};
  if (error) return Failed(url, error.message());
  return Failed(url, url.path + " was answered with '" + answer + "', expected HTTP/1.1 200");
}

}  // namespace strata::server
