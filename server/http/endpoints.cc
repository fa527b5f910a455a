// The table of endpoints, and those that say how the service is.
#include <array>
#include <string>

#include "server/http/handlers.h"
#include "server/http/openapi.h"
#include "server/http/router.h"
#include "server/http/viewer_files.h"
#include "server/service/stored_service.h"

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
  if (const auto stored = service.stored()) {
    if (const auto ready = (*stored)->CheckReady(); !ready) {
      return exchange.RespondProblem(ready.error());
    }
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

void ShowViewer(Service&, Exchange& exchange, const std::string&) { RespondViewerFile(exchange); }

using Access = Route::Access;

constexpr std::array<Route, 31> kRoutes = {{
    {"GET", "/", Access::kOpen, false, ShowViewer},
    {"GET", "/assets/{file...}", Access::kOpen, false, ShowViewer},
    {"GET", "/livez", Access::kOpen, false, Livez},
    {"GET", "/readyz", Access::kOpen, false, Readyz},
    {"GET", "/metrics", Access::kRead, false, ShowMetrics},
    {"GET", "/openapi.json", Access::kOpen, false, ShowOpenApi},
    {"POST", "/v1/samples", Access::kFull, true, PostSamples},
    {"GET", "/v1/samples", Access::kRead, true, GetSamples},
    {"GET", "/v1/models", Access::kRead, true, ListModels},
    {"PUT", "/v1/models/{name...}", Access::kFull, true, PutModelFile},
    {"GET", "/v1/models/{name...}", Access::kRead, true, GetModel},
    {"DELETE", "/v1/models/{name...}", Access::kFull, true, DeleteModel},
    {"POST", "/v1/jobs", Access::kFull, true, PostJob},
    {"GET", "/v1/jobs", Access::kRead, true, ListJobs},
    {"GET", "/v1/jobs/{id}", Access::kRead, true, GetJob},
    {"DELETE", "/v1/jobs/{id}", Access::kFull, true, DeleteJob},
    {"GET", "/v1/jobs/{id}/events", Access::kRead, true, GetJobEvents},
    {"GET", "/v1/jobs/{id}/result", Access::kRead, true, GetJobResult},
    {"POST", "/v1/batches", Access::kFull, true, PostBatch},
    {"GET", "/v1/batches", Access::kRead, true, ListBatches},
    {"GET", "/v1/batches/{id}", Access::kRead, true, GetBatch},
    {"DELETE", "/v1/batches/{id}", Access::kFull, true, DeleteBatch},
    {"GET", "/v1/batches/{id}/events", Access::kRead, true, GetBatchEvents},
    {"GET", "/v1/batches/{id}/manifest", Access::kRead, true, GetBatchManifest},
    {"GET", "/v1/batches/{id}/output", Access::kRead, true, GetBatchOutput},
    {"OPTIONS", "/v1/uploads", Access::kOpen, false, TusOptions},
    {"POST", "/v1/uploads", Access::kFull, true, TusCreate},
    {"HEAD", "/v1/uploads/{id}", Access::kFull, true, TusHead},
    {"PATCH", "/v1/uploads/{id}", Access::kFull, true, TusPatch},
    {"DELETE", "/v1/uploads/{id}", Access::kFull, true, TusDelete},
    {"OPTIONS", "/v1/uploads/{id}", Access::kOpen, false, TusOptions},
}};

}  // namespace

std::span<const Route> Routes() { return kRoutes; }

}  // namespace strata::server
