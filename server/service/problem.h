// A failure on its way to a client, whatever the protocol.
#pragma once

#include <string>
#include <string_view>
#include <tl/expected.hpp>

#include "server/exit_codes.h"
#include "strata/v1/errors.pb.h"

namespace strata::server {

/// One occurrence of a row of the table in exit_codes.h.
struct Problem {
  int http_status = 500;
  int grpc_status = 13;
  const char* type = "internal";  ///< Without "/problems/". Lives as long as the program.
  const char* title = "";         ///< Likewise.
  std::string detail;             ///< For a person: what was found, what was expected.
  int retry_after_s = 0;          ///< 0: none.
  /// The code of the Error it came from; of a refusal kInvalidArgument.
  ErrorCode code = ErrorCode::kInvalidArgument;
  const ErrorKind* kind = nullptr;  ///< Likewise.
};

/// Either a T or why the client does not get one.
template <class T>
using Answer = tl::expected<T, Problem>;

/// Of an error of a database or a bucket that is away (IsStoreAway): kUnavailable, with its code.
Problem ProblemOf(const Error& error);
Problem ProblemOf(Refusal refusal, std::string detail, int retry_after_s = 0);

/// The same as the failing side of any Answer.
inline tl::unexpected<Problem> Refuse(const Error& error) {
  return tl::unexpected<Problem>(ProblemOf(error));
}
inline tl::unexpected<Problem> Refuse(Refusal refusal, std::string detail, int retry_after_s = 0) {
  return tl::unexpected<Problem>(ProblemOf(refusal, std::move(detail), retry_after_s));
}
template <class T>
tl::unexpected<Problem> Pass(const Answer<T>& failed) {
  return tl::unexpected<Problem>(failed.error());
}

/// The message both protocols send. Bytes of `detail` that are not UTF-8 become U+FFFD.
v1::Problem ToMessage(const Problem& problem, std::string_view request_id);

/// `text` with every byte that is not part of valid UTF-8 replaced by U+FFFD.
std::string ValidUtf8(std::string_view text);

}  // namespace strata::server
