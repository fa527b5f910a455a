// /v1/models: meshes that are uploaded once and sampled often.
#include <algorithm>
#include <charconv>
#include <optional>
#include <string>

#include "server/http/conditional.h"
#include "server/http/handlers.h"
#include "server/http/parts.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

/// The hash in an entity tag: `"…"` → `…`; anything else as it is, and fits no model.
std::string Unquoted(std::string tag) {
  std::erase(tag, '"');
  return tag;
}

Answer<StoredService::Put> Put(Service& service, Exchange& exchange, const std::string& name) {
  const auto stored = service.stored();
  if (!stored) return Pass(stored);
  if (auto type = CheckMeshType(exchange); !type) return Pass(type);
  v1::PutModelHeader header;
  header.set_name(name);
  header.set_if_absent(exchange.header("If-None-Match") == "*");
  header.set_if_sha256(Unquoted(exchange.header("If-Match")));
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
  auto query = exchange.target().query;
  const bool content =
      std::ranges::any_of(query, [](const auto& p) { return p.first == "content"; });
  if (content) {
    const auto opened = (*stored)->OpenModelContent(name);
    if (!opened) return exchange.RespondProblem(opened.error());
    return RespondConditional(exchange, *opened, {{"Cache-Control", "no-cache"}});
  }
  const auto model = (*stored)->GetModel(name);
  if (!model) return exchange.RespondProblem(model.error());
  RespondMessage(exchange, 200, *model, {{"ETag", '"' + model->sha256() + '"'}});
}

void DeleteModel(Service& service, Exchange& exchange, const std::string& name) {
  const auto stored = service.stored();
  if (!stored) return exchange.RespondProblem(stored.error());
  const auto deleted = (*stored)->DeleteModel(name, Unquoted(exchange.header("If-Match")));
  if (!deleted) return exchange.RespondProblem(deleted.error());
  exchange.Respond(204, {}, "");
}

}  // namespace strata::server
