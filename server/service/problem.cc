#include "server/service/problem.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "server/store/object_place.h"

namespace strata::server {
namespace {

constexpr int kAwayRetryAfter = 5;  // Seconds: about what reconnecting takes.

}  // namespace

Problem ProblemOf(const Error& error) {
  if (IsStoreAway(error)) {
    Problem problem = ProblemOf(Refusal::kUnavailable, error.message, kAwayRetryAfter);
    problem.code = error.code;
    problem.kind = error.kind;
    return problem;
  }
  const ExitCode& row = ExitCodeOf(error.code);
  return {row.http_status, row.grpc_status, row.type, row.meaning, error.message, 0,
          error.code,      error.kind};
}

Problem ProblemOf(Refusal refusal, std::string detail, int retry_after_s) {
  const RefusalRow& row = RowOf(refusal);
  return {row.http_status, row.grpc_status,   row.type,
          row.meaning,     std::move(detail), retry_after_s};
}

v1::Problem ToMessage(const Problem& problem, std::string_view request_id) {
  v1::Problem message;
  message.set_type(std::string("/problems/") + problem.type);
  message.set_title(problem.title);
  message.set_status(static_cast<std::uint32_t>(problem.http_status));
  message.set_detail(ValidUtf8(problem.detail));
  message.set_request_id(std::string(request_id));
  message.set_retry_after(static_cast<std::uint32_t>(problem.retry_after_s));
  return message;
}

std::string ValidUtf8(std::string_view text) {
  using nlohmann::json;
  const std::string quoted = json(text).dump(-1, ' ', false, json::error_handler_t::replace);
  return json::parse(quoted).get<std::string>();
}

}  // namespace strata::server
