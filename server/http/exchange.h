// One request and its answer.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/http/request_target.h"
#include "server/service/api_keys.h"
#include "server/service/problem.h"
#include "server/service/service.h"

namespace strata::server {

/// What bounds a connection. Bytes and seconds.
struct HttpLimits {
  std::uint32_t connections = 512;
  std::uint32_t header_bytes = 16 << 10;
  std::uint32_t header_fields = 64;
  std::uint32_t header_seconds = 10;  ///< For a whole header, TLS's handshake likewise.
  std::uint32_t idle_seconds = 60;    ///< Between requests.
  /// Bodies may not be slower than this on average, either way, beyond the first grace_seconds.
  std::uint64_t bytes_per_second = 1024;
  std::uint32_t grace_seconds = 10;
};

using Headers = std::vector<std::pair<std::string, std::string>>;

/// What the handler of an endpoint sees of a connection. Answers exactly once. Threads: one.
class Exchange {
 public:
  virtual ~Exchange() = default;

  virtual std::string_view method() const = 0;
  virtual const RequestTarget& target() const = 0;
  /// The value of a request header, empty if there is none; name in any case.
  virtual std::string header(std::string_view name) const = 0;

  /// Hands the body to `sink` piece by piece; what it refuses ends the reading. Bytes beyond
  /// `limit` are not read. Refuses: kBodyTooLarge, kTooSlow, kMalformed (ends early), cancelled
  /// (the client went).
  virtual Answer<void> ReadBody(std::uint64_t limit,
                                const std::function<Answer<void>(std::string_view)>& sink) = 0;
  /// Whether the client has closed the connection.
  virtual bool ClientGone() const = 0;
  /// Who asks, once the key was checked.
  virtual const Caller& caller() const = 0;
  virtual void SetCaller(Caller caller) = 0;

  virtual void Respond(int status, const Headers& headers, std::string_view body) = 0;
  /// Answers with `size` bytes of `content` from `offset`.
  virtual void RespondContent(int status, const Headers& headers, const Content& content,
                              std::uint64_t offset, std::uint64_t size) = 0;
  /// Begins an answer whose length is not known; Stream adds to it and says whether the client
  /// still takes it. The connection's end is the answer's.
  virtual void BeginStream(int status, const Headers& headers) = 0;
  virtual bool Stream(std::string_view bytes) = 0;
  virtual void RespondProblem(const Problem& problem, const Headers& headers = {}) = 0;
};

}  // namespace strata::server
