// /v1/batches: sampling the repository of the service.
#include <string>

#include "server/batch/batch_service.h"
#include "server/http/conditional.h"
#include "server/http/handlers.h"
#include "server/http/parts.h"
#include "server/service/canonical_options.h"

namespace strata::server {
namespace {

/// Calls `work` with the batches, if they are to be had, and answers with what it returns.
template <class Work>
void RespondWith(const Answer<BatchService*>& batches, Exchange& exchange, Work work) {
  if (!batches) return exchange.RespondProblem(batches.error());
  const auto answer = work(**batches);
  if (!answer) return exchange.RespondProblem(answer.error());
  RespondMessage(exchange, 200, *answer);
}

void RespondContent(Exchange& exchange, const Answer<Content>& content) {
  if (!content) return exchange.RespondProblem(content.error());
  RespondConditional(exchange, *content, {{"Cache-Control", "no-store"}});
}

Answer<v1::Batch> Create(Service& service, Exchange& exchange) {
  const auto batches = WithoutParameters(service.batches(), exchange);
  if (!batches) return Pass(batches);
  v1::CreateBatchRequest request;
  if (auto filled = JsonBodyInto(exchange, request); !filled) return Pass(filled);
  return (*batches)->Create(request);
}

/// One server-sent event: the batch as one line of JSON.
std::string EventText(const v1::Batch& batch) {
  return "event: batch\ndata: " + JsonOf(batch) + "\n\n";
}

}  // namespace

void PostBatch(Service& service, Exchange& exchange, const std::string&) {
  const auto created = Create(service, exchange);
  if (!created) return exchange.RespondProblem(created.error());
  RespondMessage(exchange, 202, *created, {{"Location", "/v1/batches/" + created->id()}});
}

void ListBatches(Service& service, Exchange& exchange, const std::string&) {
  RespondWith(service.batches(), exchange,
              [&](BatchService& batches) -> Answer<v1::ListBatchesResponse> {
                v1::ListBatchesRequest request;
                if (auto filled = QueryInto(exchange.target(), request); !filled)
                  return Pass(filled);
                return batches.List(request);
              });
}

void GetBatch(Service& service, Exchange& exchange, const std::string& id) {
  RespondWith(WithoutParameters(service.batches(), exchange), exchange,
              [&](BatchService& batches) { return batches.Get(id); });
}

void DeleteBatch(Service& service, Exchange& exchange, const std::string& id) {
  RespondWith(WithoutParameters(service.batches(), exchange), exchange,
              [&](BatchService& batches) { return batches.Cancel(id); });
}

void GetBatchEvents(Service& service, Exchange& exchange, const std::string& id) {
  const auto batches = WithoutParameters(service.batches(), exchange);
  if (!batches) return exchange.RespondProblem(batches.error());
  if (const auto batch = (*batches)->Get(id); !batch) {
    return exchange.RespondProblem(batch.error());
  }
  exchange.BeginStream(200, {{"Content-Type", "text/event-stream"}, {"Cache-Control", "no-store"}});
  if (exchange.method() == "HEAD") return;
  static_cast<void>((*batches)->Watch(
      id, [&](const v1::Batch& batch) { return exchange.Stream(EventText(batch)); },
      [&exchange] { return exchange.ClientGone(); }));
}

void GetBatchManifest(Service& service, Exchange& exchange, const std::string& id) {
  const auto batches = WithoutParameters(service.batches(), exchange);
  if (!batches) return exchange.RespondProblem(batches.error());
  RespondContent(exchange, (*batches)->OpenManifest(id));
}

void GetBatchOutput(Service& service, Exchange& exchange, const std::string& id) {
  const auto batches = service.batches();
  if (!batches) return exchange.RespondProblem(batches.error());
  v1::DownloadOutputRequest request;
  if (auto filled = QueryInto(exchange.target(), request); !filled) {
    return exchange.RespondProblem(filled.error());
  }
  RespondContent(exchange, (*batches)->OpenOutput(id, request.path()));
}

}  // namespace strata::server
