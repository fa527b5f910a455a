// The bytes of one connection, each read and write with a deadline.
#pragma once

#include <boost/system/error_code.hpp>
#include <chrono>
#include <cstddef>
#include <memory>

namespace strata::server {

using SteadyClock = std::chrono::steady_clock;

/// A connected socket, plain or under TLS. Blocking, with a deadline: threads wait here and nowhere
/// else. Threads: one at a time.
class Transport {
 public:
  virtual ~Transport() = default;

  /// Reads or writes at least one byte. Errors: asio::error::timed_out at the deadline, eof when
  /// the peer is done, the system's.
  virtual std::size_t ReadSome(void* into, std::size_t size, boost::system::error_code& error) = 0;
  virtual std::size_t WriteSome(const void* from, std::size_t size,
                                boost::system::error_code& error) = 0;
  /// What must come before the first byte: TLS's handshake. Errors: as ReadSome.
  virtual void Handshake(boost::system::error_code& error) = 0;
  /// Sends what remains and tells the peer that nothing more comes.
  virtual void FinishWriting() = 0;

  /// Of all later calls.
  virtual void SetDeadline(SteadyClock::time_point deadline) = 0;
  /// While `stop` is not -1, waiting also ends when it becomes readable: operation_aborted.
  virtual void SetStop(int stop) = 0;
  virtual int descriptor() const = 0;
};

/// Whether the peer of `socket` has closed it, or its own half of it.
bool PeerIsGone(int socket);

/// Takes over a connected socket.
std::unique_ptr<Transport> PlainTransport(int socket);

}  // namespace strata::server
