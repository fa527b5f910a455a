// The endpoints: each translates a request into a call of Service and back.
#include <array>
#include <nlohmann/json.hpp>
#include <string>

#include "server/http/accept_header.h"
#include "server/http/openapi.h"
#include "server/http/router.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {

// --- How the service is
// ---------------------------------------------------------------------------

void Livez(Service&, Exchange& exchange, const std::string&) {
  exchange.Respond(200, {{"Content-Type", "text/plain"}, {"Cache-Control", "no-store"}}, "ok\n");
}

void Readyz(Service& service, Exchange& exchange, const std::string&) {
  if (!service.ready()) {
    return exchange.RespondProblem(ProblemOf(Refusal::kUnavailable, "shutting down", 10));
  }
  Livez(service, exchange, {});
}

void ShowMetrics(Service& service, Exchange& exchange, const std::string&) {
  exchange.Respond(
      200,
      {{"Content-Type", "text/plain; version=0.0.4; charset=utf-8"}, {"Cache-Control", "no-store"}},
      service.metrics().Text());
}

void ShowOpenApi(Service&, Exchange& exchange, const std::string&) {
  exchange.Respond(200, {{"Content-Type", "application/json"}}, OpenApiText());
}

// --- Sampling at once
// -----------------------------------------------------------------------------

Answer<v1::SampleOptions> OptionsOf(const Exchange& exchange) {
  auto options = OptionsFromTexts(exchange.target().query);
  if (!options) return Refuse(options.error());
  if (!options->has_format()) {
    auto format = FormatForAccept(exchange.header("Accept"));
    if (!format) return Pass(format);
    options->set_format(*std::move(format));
  }
  return *std::move(options);
}

/// A mesh file is sent as it is: what wraps it in something else is refused by name, because its
/// bytes would be read as a broken mesh.
Answer<void> CheckMeshType(const Exchange& exchange) {
  const std::string type = exchange.header("Content-Type");
  if (type.starts_with("multipart/") || type.starts_with("application/json")) {
    return Refuse(Refusal::kMediaType, "Content-Type: found '" + type +
                                           "', expected the bytes of a mesh file as the body, "
                                           "such as application/octet-stream");
  }
  const std::string coding = exchange.header("Content-Encoding");
  if (!coding.empty() && coding != "gzip" && coding != "zstd" && coding != "identity") {
    return Refuse(Refusal::kMediaType,
                  "Content-Encoding: found '" + coding + "', expected gzip, zstd or none");
  }
  return {};
}

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

/// On one line and in ASCII, as a header must be.
std::string OneLine(const std::string& json) {
  return nlohmann::ordered_json::parse(json).dump(-1, ' ', true);
}

void RespondSampled(Exchange& exchange, const v1::SampleOptions& options, const Sampled& sampled) {
  const v1::SampleSummary& summary = sampled.summary;
  exchange.RespondFile(
      200,
      {{"Content-Type", summary.media_type()},
       {"Content-Disposition", "attachment; filename=\"samples." + options.format() + "\""},
       {"Vary", "Accept"},
       {"Strata-Summary", OneLine(summary.json())}},
      *sampled.file, 0, summary.size_bytes());
}

void PostSamples(Service& service, Exchange& exchange, const std::string&) {
  const auto options = OptionsOf(exchange);
  if (!options) return exchange.RespondProblem(options.error());
  if (auto type = CheckMeshType(exchange); !type) return exchange.RespondProblem(type.error());
  const auto mesh = ReceiveMesh(service, exchange);
  if (!mesh) return exchange.RespondProblem(mesh.error());
  JobWatch watch;
  watch.gone = [&exchange] { return exchange.ClientGone(); };
  const auto sampled = service.Sample(*options, mesh->file(), "body", watch);
  if (!sampled) return exchange.RespondProblem(sampled.error());
  RespondSampled(exchange, *options, *sampled);
}

using Access = Route::Access;

constexpr std::array<Route, 5> kRoutes = {{
    {"GET", "/livez", Access::kOpen, false, Livez},
    {"GET", "/readyz", Access::kOpen, false, Readyz},
    {"GET", "/metrics", Access::kRead, false, ShowMetrics},
    {"GET", "/openapi.json", Access::kOpen, false, ShowOpenApi},
    {"POST", "/v1/samples", Access::kFull, true, PostSamples},
}};

}  // namespace

std::span<const Route> Routes() { return kRoutes; }

}  // namespace strata::server
