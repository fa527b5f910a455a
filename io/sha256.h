// SHA-256 of bytes in memory.
#pragma once

#include <span>
#include <string>

namespace strata::io {

/// 64 hex digits, lower case; empty if the library refuses (out of memory).
std::string Sha256Hex(std::span<const char> bytes);

}  // namespace strata::io
