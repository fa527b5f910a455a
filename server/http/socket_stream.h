// A socket as Asio's synchronous streams see one, with a deadline. For TLS and plain transports.
#pragma once

#include <boost/asio/buffer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/system/error_code.hpp>

#include "server/http/transport.h"

namespace strata::server {

/// Owns the socket, which it makes non-blocking.
class SocketStream {
 public:
  using executor_type = boost::asio::io_context::executor_type;
  using lowest_layer_type = SocketStream;

  explicit SocketStream(int socket);
  ~SocketStream();
  SocketStream(const SocketStream&) = delete;
  SocketStream& operator=(const SocketStream&) = delete;

  std::size_t Read(void* into, std::size_t size, boost::system::error_code& error);
  std::size_t Write(const void* from, std::size_t size, boost::system::error_code& error);

  template <class Buffers>
  std::size_t read_some(const Buffers& buffers, boost::system::error_code& error) {
    const boost::asio::mutable_buffer first = *boost::asio::buffer_sequence_begin(buffers);
    return Read(first.data(), first.size(), error);
  }
  template <class Buffers>
  std::size_t write_some(const Buffers& buffers, boost::system::error_code& error) {
    const boost::asio::const_buffer first = *boost::asio::buffer_sequence_begin(buffers);
    return Write(first.data(), first.size(), error);
  }
  /// Asio's TLS asks for one; nothing ever runs on it.
  executor_type get_executor();
  lowest_layer_type& lowest_layer() { return *this; }

  void SetDeadline(SteadyClock::time_point deadline) { deadline_ = deadline; }
  void SetStop(int stop) { stop_ = stop; }
  int descriptor() const { return socket_; }

 private:
  bool Wait(short events, boost::system::error_code& error) const;

  int socket_;
  int stop_ = -1;
  SteadyClock::time_point deadline_ = SteadyClock::time_point::max();
};

}  // namespace strata::server
