// The one table from a failure's kind to what the outside sees of it.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "core/result.h"

namespace strata::server {

/// How one ErrorCode looks to a shell, over HTTP and over gRPC.
struct ExitCode {
  ErrorCode code;
  int exit_status;      ///< Of the process; 0 is success, 128 + n is death by signal n.
  int http_status;      ///< RFC 9110 (499: the client went away).
  int grpc_status;      ///< google.rpc.Code.
  const char* meaning;  ///< For --help: when this happens.
};

/// One row per ErrorCode, in the order of the enumeration.
inline constexpr std::array<ExitCode, kErrorCodeCount> kExitCodes = {{
    {ErrorCode::kInvalidArgument, 2, 400, 3,
     "an option is unknown, out of range or contradicts another"},
    {ErrorCode::kNotFound, 3, 404, 5, "the input does not exist or may not be opened"},
    {ErrorCode::kCorruptInput, 4, 422, 15,
     "the input contradicts its own format (or --strict found a skip)"},
    {ErrorCode::kUnsupported, 5, 415, 12, "the input's format is not one that Strata reads"},
    {ErrorCode::kEmptySurface, 6, 422, 9, "the input holds no triangle of positive area"},
    {ErrorCode::kOverBudget, 7, 503, 8,
     "the work does not fit a limit (lattice, memory, output format)"},
    {ErrorCode::kIo, 8, 507, 14, "a read or write failed (disk full included)"},
    {ErrorCode::kCancelled, 130, 499, 1, "stopped by Ctrl-C (143: by SIGTERM, 129: by SIGHUP)"},
    {ErrorCode::kConflict, 9, 409, 10,
     "what is stored contradicts the request, or another process owns it"},
    {ErrorCode::kInternal, 70, 500, 13, "a defect in Strata: please report it"},
}};

static_assert(std::ranges::is_sorted(kExitCodes, {}, &ExitCode::code) &&
                  static_cast<int>(kExitCodes.back().code) == kErrorCodeCount - 1,
              "every ErrorCode has its row, in order");

/// The row of `code`.
constexpr const ExitCode& ExitCodeOf(ErrorCode code) {
  return kExitCodes[static_cast<std::size_t>(code)];
}

}  // namespace strata::server
