#include "server/http/http_exchange.h"

#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <boost/asio/error.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/write.hpp>
#include <vector>

#include "core/version.h"
#include "server/service/request_id.h"

namespace strata::server {
namespace {

namespace http = boost::beast::http;
using boost::system::error_code;

/// When the next byte must have moved: soon enough for the average since `start`, and within the
/// grace whatever moved before, so that no burst buys a long silence.
SteadyClock::time_point RateDeadline(const HttpLimits& limits, SteadyClock::time_point start,
                                     std::uint64_t bytes) {
  const std::chrono::seconds grace(limits.grace_seconds);
  const std::chrono::seconds earned(bytes / std::max<std::uint64_t>(1, limits.bytes_per_second));
  return std::min(start + grace + earned, SteadyClock::now() + grace);
}

}  // namespace

HttpExchange::HttpExchange(const HttpShared& shared, Transport& transport,
                           boost::beast::flat_buffer& buffer, RequestParser& parser)
    : shared_(shared),
      transport_(transport),
      buffer_(buffer),
      parser_(parser),
      reusable_(parser.get().keep_alive()) {
  request_id_ = RequestIdOf(header("X-Request-Id"));
}

std::string_view HttpExchange::method() const {
  const auto text = parser_.get().method_string();
  return {text.data(), text.size()};
}

std::string HttpExchange::header(std::string_view name) const {
  const auto& fields = parser_.get().base();
  const auto found = fields.find(boost::string_view(name.data(), name.size()));
  if (found == fields.end()) return {};
  return {found->value().data(), found->value().size()};
}

// --- The request's body --------------------------------------------------------------------------

Answer<void> HttpExchange::CheckExpectation() {
  const std::string expected = header("Expect");
  if (expected.empty() || parser_.is_done() || parser_.get().version() < 11) return {};
  if (!boost::beast::iequals(expected, "100-continue")) {
    return Refuse(Refusal::kMalformed, "Expect: found '" + expected + "', expected 100-continue");
  }
  if (buffer_.size() > 0) return {};  // The body is on its way already.
  constexpr std::string_view kContinue = "HTTP/1.1 100 Continue\r\n\r\n";
  transport_.SetDeadline(SteadyClock::now() + std::chrono::seconds(shared_.limits.grace_seconds));
  error_code error;
  BeastStream stream(transport_);
  boost::asio::write(stream, boost::asio::buffer(kContinue.data(), kContinue.size()), error);
  if (error) return Refuse(Error{ErrorCode::kCancelled, "the client went away"});
  return {};
}

/// Up to `size` bytes of the body; 0 of them is not the end: parser_.is_done() is.
Answer<std::size_t> HttpExchange::ReadPiece(char* into, std::size_t size) {
  auto& body = parser_.get().body();
  body.data = into;
  body.size = size;
  error_code error;
  BeastStream stream(transport_);
  http::read_some(stream, buffer_, parser_, error);
  const std::size_t got = size - body.size;
  if (!error || error == http::error::need_buffer) return got;
  reusable_ = false;
  const std::string where = " after " + std::to_string(bytes_in_ + got) + " bytes";
  if (error == boost::asio::error::timed_out) {
    return Refuse(Refusal::kTooSlow, "the body came in slower than " +
                                         std::to_string(shared_.limits.bytes_per_second) +
                                         " bytes a second" + where);
  }
  if (error == http::error::buffer_overflow) {
    return Refuse(Refusal::kHeaderTooLarge,
                  "a chunk's extension, or the trailer, is larger than allowed," + where);
  }
  if (error == http::error::partial_message || error == http::error::end_of_stream) {
    return Refuse(Refusal::kMalformed, "the body ends early," + where);
  }
  if (error.category() == make_error_code(http::error::bad_chunk).category()) {
    return Refuse(Refusal::kMalformed, "the body is broken" + where + ": " + error.message());
  }
  return Refuse(Error{ErrorCode::kCancelled, "the client went away" + where});
}

Answer<void> HttpExchange::ReadBody(std::uint64_t limit,
                                    const std::function<Answer<void>(std::string_view)>& sink) {
  const auto too_large = [&] {
    return Refuse(Refusal::kBodyTooLarge,
                  "the body is larger than the " + std::to_string(limit) + " bytes allowed");
  };
  if (const auto length = parser_.content_length(); length && *length > limit) return too_large();
  if (auto expected = CheckExpectation(); !expected) return expected;
  std::vector<char> piece(kBodyPiece);
  buffer_.reserve(kBodyPiece);
  const auto start = SteadyClock::now();
  while (!parser_.is_done()) {
    transport_.SetDeadline(RateDeadline(shared_.limits, start, bytes_in_));
    const auto got = ReadPiece(piece.data(), piece.size());
    if (!got) return Pass(got);
    bytes_in_ += *got;
    if (bytes_in_ > limit) return too_large();
    if (*got == 0) continue;
    if (auto taken = sink({piece.data(), *got}); !taken) return taken;
  }
  return {};
}

// --- The answer ----------------------------------------------------------------------------------

bool HttpExchange::SendHeader(int status, const Headers& headers,
                              std::optional<std::uint64_t> size) {
  status_ = status;
  if (!parser_.is_done() || shared_.service.ready() == false) reusable_ = false;
  http::response<http::empty_body> response;
  response.version(parser_.get().version() < 11 ? 10 : 11);
  response.result(static_cast<unsigned>(status));
  response.set(http::field::server, "strata/" + std::string(kVersion));
  response.set("X-Request-Id", request_id_);
  response.set("X-Content-Type-Options", "nosniff");
  for (const auto& [name, value] : headers) response.insert(name, value);
  if (size && status != 204 && status != 304) response.content_length(*size);
  response.keep_alive(reusable_);
  started_sending_ = SteadyClock::now();
  transport_.SetDeadline(RateDeadline(shared_.limits, started_sending_, 0));
  error_code error;
  BeastStream stream(transport_);
  http::response_serializer<http::empty_body> serializer(response);
  http::write_header(stream, serializer, error);
  if (error) reusable_ = false;
  return !error;
}

bool HttpExchange::Send(std::string_view bytes) {
  BeastStream stream(transport_);
  while (!bytes.empty()) {
    transport_.SetDeadline(RateDeadline(shared_.limits, started_sending_, bytes_out_));
    error_code error;
    const std::size_t n = stream.write_some(boost::asio::buffer(bytes.data(), bytes.size()), error);
    if (error) {
      reusable_ = false;
      return false;
    }
    bytes_out_ += n;
    bytes.remove_prefix(n);
  }
  return true;
}

void HttpExchange::Respond(int status, const Headers& headers, std::string_view body) {
  if (SendHeader(status, headers, body.size()) && method() != "HEAD") Send(body);
}

void HttpExchange::RespondContent(int status, const Headers& headers, const Content& content,
                                  std::uint64_t offset, std::uint64_t size) {
  if (!SendHeader(status, headers, size) || method() == "HEAD") return;
  std::vector<char> piece(std::min<std::uint64_t>(size, 4 * kBodyPiece));
  for (std::uint64_t sent = 0; sent < size;) {
    const std::size_t now = std::min<std::uint64_t>(piece.size(), size - sent);
    // After the header no other answer is possible: a broken connection says that it failed.
    if (!content.read(offset + sent, {piece.data(), now}) || !Send({piece.data(), now})) {
      reusable_ = false;
      return;
    }
    sent += now;
  }
}

void HttpExchange::BeginStream(int status, const Headers& headers) {
  reusable_ = false;  // HTTP/1.1 without a length: the connection's end is the body's.
  SendHeader(status, headers, std::nullopt);
}

bool HttpExchange::Stream(std::string_view bytes) {
  started_sending_ = SteadyClock::now();  // Each piece anew: what is not there yet is not slow.
  return Send(bytes);
}

void HttpExchange::RespondProblem(const Problem& problem, const Headers& headers) {
  google::protobuf::util::JsonPrintOptions print;
  print.preserve_proto_field_names = true;
  std::string body;
  static_cast<void>(
      google::protobuf::util::MessageToJsonString(ToMessage(problem, request_id_), &body, print));
  Headers all = headers;
  all.emplace_back("Content-Type", "application/problem+json");
  all.emplace_back("Cache-Control", "no-store");
  if (problem.retry_after_s > 0) {
    all.emplace_back("Retry-After", std::to_string(problem.retry_after_s));
  }
  if (problem.http_status == 401) all.emplace_back("WWW-Authenticate", "Bearer");
  Respond(problem.http_status, all, body + '\n');
}

}  // namespace strata::server
