// /v1/models: meshes that are uploaded once and sampled often.
#include <charconv>
#include <optional>
#include <string>

#include "server/http/conditional.h"
#include "server/http/handlers.h"
#include "server/http/parts.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

/// The SHA-256 that a change of the model `name` asks for, empty for any; told before the body is
/// read, and held by the store when it comes to the change. Refuses: kPrecondition.
Answer<std::string> ConditionOf(StoredService& stored, const Exchange& exchange,
                                const std::string& name) {
  const std::string match = exchange.header("If-Match");
  const std::string none_match = exchange.header("If-None-Match");
  if (match.empty() && none_match.empty()) return std::string();
  const auto model = stored.GetModel(name);
  if (!model && model.error().code != ErrorCode::kNotFound) return Pass(model);
  const std::string tag = model ? '"' + model->sha256() + '"' : std::string();
  const std::string is =
      "model " + name + (model ? ": the entity tag is " + tag : ": there is none");
  if (!match.empty() && (!model || !HasTag(match, tag, TagMatch::kStrong))) {
    return Refuse(Refusal::kPrecondition, "If-Match: " + is);
  }
  if (!none_match.empty() && model && HasTag(none_match, tag, TagMatch::kWeak)) {
    return Refuse(Refusal::kPrecondition, "If-None-Match: " + is);
  }
  return match.empty() ? std::string() : model->sha256();
}

Answer<StoredService::Put> Put(Service& service, Exchange& exchange, const std::string& name) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return Pass(stored);
  if (auto type = CheckMeshType(exchange); !type) return Pass(type);
  auto condition = ConditionOf(**stored, exchange, name);
  if (!condition) return Pass(condition);
  v1::PutModelHeader header;
  header.set_name(name);
  header.set_if_absent(exchange.header("If-None-Match") == "*");
  header.set_if_sha256(*std::move(condition));
  const std::string length = exchange.header("Content-Length");
  std::optional<std::uint64_t> size;
  std::uint64_t number = 0;
  if (std::from_chars(length.data(), length.data() + length.size(), number).ec == std::errc()) {
    size = number;
  }
  const std::uint64_t limit = service.limits().body_bytes;
  if (size && *size > limit) {
    return Refuse(Refusal::kBodyTooLarge,
                  "the body is larger than the " + std::to_string(limit) + " bytes allowed");
  }
  return (*stored)->PutModel(header, size,
                             [&](const auto& sink) { return exchange.ReadBody(limit, sink); });
}

}  // namespace

void ListModels(Service& service, Exchange& exchange, const std::string&) {
  v1::ListModelsRequest request;
  const auto stored = service.stored();
  if (!stored) return exchange.RespondProblem(stored.error());
  if (auto filled = QueryInto(exchange.target(), request); !filled) {
    return exchange.RespondProblem(filled.error());
  }
  const auto page = (*stored)->ListModels(request);
  if (!page) return exchange.RespondProblem(page.error());
  RespondMessage(exchange, 200, *page);
}

void PutModelFile(Service& service, Exchange& exchange, const std::string& name) {
  const auto put = Put(service, exchange, name);
  if (!put) return exchange.RespondProblem(put.error());
  RespondMessage(exchange, put->created ? 201 : 200, put->model,
                 {{"ETag", '"' + put->model.sha256() + '"'}});
}

void GetModel(Service& service, Exchange& exchange, const std::string& name) {
  const auto stored = service.stored();
  if (!stored) return exchange.RespondProblem(stored.error());
  const auto& query = exchange.target().query;
  if (query.size() == 1 && query.front().first == "content") {
    const auto opened = (*stored)->OpenModelContent(name);
    if (!opened) return exchange.RespondProblem(opened.error());
    return RespondConditional(exchange, *opened, {{"Cache-Control", "no-cache"}});
  }
  if (auto none = CheckNoParameters(exchange.target()); !none) {
    return exchange.RespondProblem(none.error());
  }
  const auto model = (*stored)->GetModel(name);
  if (!model) return exchange.RespondProblem(model.error());
  RespondMessage(exchange, 200, *model, {{"ETag", '"' + model->sha256() + '"'}});
}

void DeleteModel(Service& service, Exchange& exchange, const std::string& name) {
  const auto stored = WithoutParameters(service.stored(), exchange);
  if (!stored) return exchange.RespondProblem(stored.error());
  const auto condition = ConditionOf(**stored, exchange, name);
  if (!condition) return exchange.RespondProblem(condition.error());
  const auto deleted = (*stored)->DeleteModel(name, *condition);
  if (!deleted) return exchange.RespondProblem(deleted.error());
  exchange.Respond(204, {}, "");
}

}  // namespace strata::server
