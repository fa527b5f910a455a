// An Exchange over HTTP/1.1: Beast reads, the transport keeps the deadlines. Only .cc files include
// this one: Beast is slow to compile.
#pragma once

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/parser.hpp>
#include <optional>
#include <string>

#include "server/http/connection.h"
#include "server/http/exchange.h"

namespace strata::server {

/// A Transport as Beast's algorithms take streams.
class BeastStream {
 public:
  explicit BeastStream(Transport& transport) : transport_(transport) {}
  template <class Buffers>
  std::size_t read_some(const Buffers& buffers, boost::system::error_code& error) {
    const boost::asio::mutable_buffer first = *boost::asio::buffer_sequence_begin(buffers);
    return transport_.ReadSome(first.data(), first.size(), error);
  }
  template <class Buffers>
  std::size_t read_some(const Buffers& buffers) {
    boost::system::error_code error;
    const std::size_t n = read_some(buffers, error);
    if (error) throw boost::system::system_error(error);
    return n;
  }
  template <class Buffers>
  std::size_t write_some(const Buffers& buffers, boost::system::error_code& error) {
    const boost::asio::const_buffer first = *boost::asio::buffer_sequence_begin(buffers);
    return transport_.WriteSome(first.data(), first.size(), error);
  }
  template <class Buffers>
  std::size_t write_some(const Buffers& buffers) {
    boost::system::error_code error;
    const std::size_t n = write_some(buffers, error);
    if (error) throw boost::system::system_error(error);
    return n;
  }

 private:
  Transport& transport_;
};

/// Of a body, bytes at a time.
constexpr std::size_t kBodyPiece = 64 << 10;

using RequestParser = boost::beast::http::request_parser<boost::beast::http::buffer_body>;

/// Owner of nothing: connection, parser and buffer outlive it.
class HttpExchange final : public Exchange {
 public:
  HttpExchange(const HttpShared& shared, Transport& transport, boost::beast::flat_buffer& buffer,
               RequestParser& parser);

  std::string_view method() const override;
  const RequestTarget& target() const override { return target_; }
  std::string header(std::string_view name) const override;
  Answer<void> ReadBody(std::uint64_t limit,
                        const std::function<Answer<void>(std::string_view)>& sink) override;
  bool ClientGone() const override { return PeerIsGone(transport_.descriptor()); }
  void Respond(int status, const Headers& headers, std::string_view body) override;
  void RespondContent(int status, const Headers& headers, const Content& content,
                      std::uint64_t offset, std::uint64_t size) override;
  void BeginStream(int status, const Headers& headers) override;
  bool Stream(std::string_view bytes) override;
  const Caller& caller() const override { return caller_; }
  void SetCaller(Caller caller) override { caller_ = std::move(caller); }
  void RespondProblem(const Problem& problem, const Headers& headers = {}) override;

  void SetTarget(RequestTarget target) { target_ = std::move(target); }
  /// No request follows on this connection, whatever the client asked for.
  void CloseAfterwards() { reusable_ = false; }
  /// Whether another request may follow on this connection.
  bool reusable() const { return reusable_; }
  const std::string& request_id() const { return request_id_; }
  int status() const { return status_; }  ///< 0 before an answer was sent.
  std::uint64_t bytes_in() const { return bytes_in_; }
  std::uint64_t bytes_out() const { return bytes_out_; }

 private:
  Answer<void> CheckExpectation();
  Answer<std::size_t> ReadPiece(char* into, std::size_t size);
  bool SendHeader(int status, const Headers& headers, std::optional<std::uint64_t> size);
  bool Send(std::string_view bytes);

  const HttpShared& shared_;
  Transport& transport_;
  boost::beast::flat_buffer& buffer_;
  RequestParser& parser_;
  RequestTarget target_;
  Caller caller_;
  std::string request_id_;
  bool reusable_;
  int status_ = 0;
  std::uint64_t bytes_in_ = 0, bytes_out_ = 0;
  SteadyClock::time_point started_sending_;
};

}  // namespace strata::server
