// Listening sockets, for both protocols.
#pragma once

#include <cstdint>
#include <string>

#include "core/result.h"
#include "io/fd.h"

namespace strata::server {

/// A TCP socket that listens on `address` (IPv4 or IPv6, in digits) and `port` (0: any free one).
/// Errors: kInvalidArgument (no address), kIo (port in use, …).
Result<io::Fd> Listen(const std::string& address, std::uint16_t port);

/// The port of a socket that listens.
std::uint16_t PortOf(int listener);

}  // namespace strata::server
