// How much memory there is, and how much was used.
#pragma once

#include <cstdint>

namespace strata::server {

/// What this process may use: the machine's memory, or its control group's limit (version 1 or 2)
/// or its address-space limit where that is less. Bytes.
std::uint64_t UsableMemoryBytes();

/// The process's largest resident set so far. Bytes; 0 if the system does not tell.
std::uint64_t PeakMemoryBytes();

}  // namespace strata::server
