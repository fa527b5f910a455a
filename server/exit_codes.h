// The one table from a failure's kind to what the outside sees of it: a shell, HTTP, gRPC.
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
  const char* type;     ///< Stable name of the problem: "/problems/" and this (RFC 9457).
  const char* meaning;  ///< For --help and as the problem's title: when this happens.
};

/// One row per ErrorCode, in the order of the enumeration.
inline constexpr std::array<ExitCode, kErrorCodeCount> kExitCodes = {{
    {ErrorCode::kInvalidArgument, 2, 400, 3, "invalid-argument",
     "an option is unknown, out of range or contradicts another"},
    {ErrorCode::kNotFound, 3, 404, 5, "not-found", "the input does not exist or may not be opened"},
    {ErrorCode::kCorruptInput, 4, 422, 15, "corrupt-input",
     "the input contradicts its own format (or --strict found a skip)"},
    {ErrorCode::kUnsupported, 5, 415, 12, "unsupported-format",
     "the input's format is not one that Strata reads"},
    {ErrorCode::kEmptySurface, 6, 422, 9, "empty-surface",
     "the input holds no triangle of positive area"},
    {ErrorCode::kOverBudget, 7, 413, 8, "over-limit",
     "the work does not fit a limit (lattice, memory, output format)"},
    {ErrorCode::kIo, 8, 507, 14, "storage", "a read or write failed (disk full included)"},
    {ErrorCode::kCancelled, 130, 499, 1, "cancelled",
     "stopped by Ctrl-C (143: by SIGTERM, 129: by SIGHUP)"},
    {ErrorCode::kConflict, 9, 409, 10, "conflict",
     "what is stored contradicts the request, or another process owns it"},
    {ErrorCode::kInternal, 70, 500, 13, "internal", "a defect in Strata: please report it"},
}};

static_assert(std::ranges::is_sorted(kExitCodes, {}, &ExitCode::code) &&
                  static_cast<int>(kExitCodes.back().code) == kErrorCodeCount - 1,
              "every ErrorCode has its row, in order");

/// The row of `code`.
constexpr const ExitCode& ExitCodeOf(ErrorCode code) {
  return kExitCodes[static_cast<std::size_t>(code)];
}

/// What only a service refuses, before or beside any job.
enum class Refusal : std::uint8_t {
  kMalformed,        ///< The request is not well-formed: JSON, query, header, message.
  kUnauthenticated,  ///< No key, or none that is known.
  kForbidden,        ///< The key may not do this.
  kCrossSite,        ///< A browser carries it for a page of another site.
  kNoSuchPath,       ///< No endpoint has this path.
  kMethod,           ///< The endpoint does not take this method.
  kNotAcceptable,    ///< No format of the result fits the `Accept` header.
  kTooSlow,          ///< The client sent less than the upload's minimum rate, or paused too long.
  kPrecondition,     ///< A condition of the request does not hold.
  kBodyTooLarge,     ///< More bytes than one request may carry.
  kMediaType,        ///< The body is of a type that the endpoint does not take.
  kRange,            ///< No byte of the asked-for range exists.
  kMisdirected,      ///< `Host` names another host than this one.
  kTooMany,          ///< This client, or all together, asked for too much at a time.
  kHeaderTooLarge,   ///< More header bytes or fields than allowed.
  kNotImplemented,   ///< A part of the protocol that this server does not speak.
  kUnavailable,      ///< Not now: shutting down, or no room.
};
inline constexpr int kRefusalCount = 17;

/// How one Refusal looks over HTTP and over gRPC; the fields are those of ExitCode.
struct RefusalRow {
  Refusal refusal;
  int http_status, grpc_status;
  const char* type;
  const char* meaning;
};

/// One row per Refusal, in the order of the enumeration.
inline constexpr std::array<RefusalRow, kRefusalCount> kRefusals = {{
    {Refusal::kMalformed, 400, 3, "malformed-request", "the request is not well-formed"},
    {Refusal::kUnauthenticated, 401, 16, "unauthenticated", "a known API key is needed"},
    {Refusal::kForbidden, 403, 7, "forbidden", "the API key may not do this"},
    {Refusal::kCrossSite, 403, 7, "cross-site", "a page of another site sent the request"},
    {Refusal::kNoSuchPath, 404, 12, "no-such-endpoint", "no endpoint has this path"},
    {Refusal::kMethod, 405, 12, "method-not-allowed", "the endpoint does not take this method"},
    {Refusal::kNotAcceptable, 406, 3, "not-acceptable", "no format fits the Accept header"},
    {Refusal::kTooSlow, 408, 4, "too-slow", "the request arrived too slowly"},
    {Refusal::kPrecondition, 412, 9, "precondition-failed", "a condition of the request fails"},
    {Refusal::kBodyTooLarge, 413, 8, "body-too-large", "the body is larger than allowed"},
    {Refusal::kMediaType, 415, 3, "unsupported-media-type", "the body's media type is not taken"},
    {Refusal::kRange, 416, 11, "range-not-satisfiable", "the range lies beyond the end"},
    {Refusal::kMisdirected, 421, 9, "misdirected-request", "the request is for another host"},
    {Refusal::kTooMany, 429, 8, "too-many-requests", "too much is asked for at a time"},
    {Refusal::kHeaderTooLarge, 431, 8, "header-too-large", "the header is larger than allowed"},
    {Refusal::kNotImplemented, 501, 12, "not-implemented", "not a part of this server"},
    {Refusal::kUnavailable, 503, 14, "unavailable", "the service cannot take this now"},
}};

static_assert(std::ranges::is_sorted(kRefusals, {}, &RefusalRow::refusal) &&
                  static_cast<int>(kRefusals.back().refusal) == kRefusalCount - 1,
              "every Refusal has its row, in order");

/// The row of `refusal`.
constexpr const RefusalRow& RowOf(Refusal refusal) {
  return kRefusals[static_cast<std::size_t>(refusal)];
}

}  // namespace strata::server
