// /v1/samples: sampling at once.
#include <string>

#include "server/http/conditional.h"
#include "server/http/handlers.h"
#include "server/http/parts.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

Answer<Upload> ReceiveMesh(Service& service, Exchange& exchange) {
  auto upload = service.BeginUpload();
  if (!upload) return upload;
  const auto received = exchange.ReadBody(
      service.limits().body_bytes, [&](std::string_view bytes) { return upload->Append(bytes); });
  if (!received) return Pass(received);
  if (upload->file().size() == 0) {
    return Refuse(Refusal::kMalformed, "the body is empty, expected the bytes of a mesh file");
  }
  return upload;
}

JobWatch WatchOf(const Exchange& exchange) {
  JobWatch watch;
  watch.gone = [&exchange] { return exchange.ClientGone(); };
  return watch;
}

Answer<Sampled> SampleBody(Service& service, Exchange& exchange) {
  const auto options = SampleOptionsOf(exchange, exchange.target().query);
  if (!options) return Pass(options);
  if (auto type = CheckMeshType(exchange); !type) return Pass(type);
  const auto mesh = ReceiveMesh(service, exchange);
  if (!mesh) return Pass(mesh);
  return service.Sample(*options, mesh->file().descriptor(), "body", WatchOf(exchange));
}

Answer<Sampled> SampleStored(Service& service, Exchange& exchange) {
  const auto stored = service.stored();
  if (!stored) return Pass(stored);
  auto query = exchange.target().query;
  const std::string model = TakeFromQuery(query, "model");
  if (model.empty()) {
    return Refuse(Error{ErrorCode::kInvalidArgument, "model: missing, expected a model's name"});
  }
  const auto options = SampleOptionsOf(exchange, query);
  if (!options) return Pass(options);
  return (*stored)->SampleModel(*options, model, WatchOf(exchange));
}

}  // namespace

void PostSamples(Service& service, Exchange& exchange, const std::string&) {
  const auto sampled = SampleBody(service, exchange);
  if (!sampled) return exchange.RespondProblem(sampled.error());
  Headers headers = ResultHeaders(*sampled);
  headers.emplace_back("Content-Type", sampled->content.media_type);
  exchange.RespondContent(200, headers, sampled->content, 0, sampled->content.size);
}

void GetSamples(Service& service, Exchange& exchange, const std::string&) {
  const auto sampled = SampleStored(service, exchange);
  if (!sampled) return exchange.RespondProblem(sampled.error());
  Headers headers = ResultHeaders(*sampled);
  headers.emplace_back("Cache-Control", "no-cache");  // Ask again: the name may get other bytes.
  RespondConditional(exchange, sampled->content, headers);
}

}  // namespace strata::server
