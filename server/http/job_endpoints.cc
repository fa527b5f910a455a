// /v1/jobs: sampling later.
#include <charconv>
#include <chrono>
#include <string>

#include "server/http/conditional.h"
#include "server/http/handlers.h"
#include "server/http/parts.h"
#include "server/service/canonical_options.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

void RespondJob(Exchange& exchange, const Answer<v1::Job>& job) {
  if (!job) return exchange.RespondProblem(job.error());
  RespondMessage(exchange, 200, *job);
}

Answer<StoredService::CreatedJob> Create(Service& service, Exchange& exchange) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return Pass(stored);
  v1::CreateJobRequest request;
  if (auto filled = JsonBodyInto(exchange, request); !filled) return Pass(filled);
  if (const std::string key = exchange.header("Idempotency-Key"); !key.empty()) {
    request.set_idempotency_key(key);
  }
  return (*stored)->CreateJob(request, exchange.caller().name);
}

/// One server-sent event: id, name, and the job as one line of JSON.
std::string EventText(const v1::JobEvent& event) {
  return "id: " + std::to_string(event.sequence()) + "\nevent: job\ndata: " + JsonOf(event.job()) +
         "\n\n";
}

}  // namespace

void PostJob(Service& service, Exchange& exchange, const std::string&) {
  const auto created = Create(service, exchange);
  if (!created) return exchange.RespondProblem(created.error());
  RespondMessage(exchange, 202, created->job, {{"Location", "/v1/jobs/" + created->job.id()}});
}

void ListJobs(Service& service, Exchange& exchange, const std::string&) {
  const auto stored = service.stored();
  if (!stored) return exchange.RespondProblem(stored.error());
  v1::ListJobsRequest request;
  if (auto filled = QueryInto(exchange.target(), request); !filled) {
    return exchange.RespondProblem(filled.error());
  }
  const auto page = (*stored)->ListJobs(request);
  if (!page) return exchange.RespondProblem(page.error());
  RespondMessage(exchange, 200, *page);
}

void GetJob(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = service.stored();
  if (!stored) return exchange.RespondProblem(stored.error());
  auto query = exchange.target().query;
  const std::string wait = TakeFromQuery(query, "wait");
  if (!query.empty()) {
    return exchange.RespondProblem(
        ProblemOf(Error{ErrorCode::kInvalidArgument,
                        "unknown parameter '" + query.front().first + "', expected wait"}));
  }
  if (wait.empty()) return RespondJob(exchange, (*stored)->GetJob(id));
  unsigned seconds = 0;
  const auto parsed = std::from_chars(wait.data(), wait.data() + wait.size(), seconds);
  if (parsed.ec != std::errc() || parsed.ptr != wait.data() + wait.size() || seconds > 3600) {
    return exchange.RespondProblem(
        ProblemOf(Error{ErrorCode::kInvalidArgument,
                        "wait: found '" + wait + "', expected whole seconds from 0 to 3600"}));
  }
  RespondJob(exchange, (*stored)->WaitJob(id, std::chrono::seconds(seconds),
                                          [&exchange] { return exchange.ClientGone(); }));
}

void DeleteJob(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return exchange.RespondProblem(stored.error());
  RespondJob(exchange, (*stored)->CancelJob(id));
}

void GetJobEvents(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return exchange.RespondProblem(stored.error());
  v1::WatchJobRequest request;
  request.set_id(id);
  const std::string last = exchange.header("Last-Event-ID");
  std::uint64_t sequence = 0;
  std::from_chars(last.data(), last.data() + last.size(), sequence);
  request.set_after_sequence(sequence);
  if (const auto job = (*stored)->GetJob(id); !job) return exchange.RespondProblem(job.error());
  exchange.BeginStream(200, {{"Content-Type", "text/event-stream"}, {"Cache-Control", "no-store"}});
  if (exchange.method() == "HEAD") return;
  static_cast<void>((*stored)->WatchJob(
      request, [&](const v1::JobEvent& event) { return exchange.Stream(EventText(event)); },
      [&exchange] { return exchange.ClientGone(); }));
}

void GetJobResult(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return exchange.RespondProblem(stored.error());
  const auto result = (*stored)->OpenResult(id);
  if (!result) return exchange.RespondProblem(result.error());
  RespondConditional(exchange, result->content, ResultHeaders(*result));
}

}  // namespace strata::server
