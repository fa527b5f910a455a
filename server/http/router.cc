#include "server/http/router.h"

#include <algorithm>
#include <optional>
#include <string_view>

namespace strata::server {
namespace {

/// What `path` has in the place of the pattern's parameter ("" without one); nothing: no match.
std::optional<std::string> Match(std::string_view pattern, std::string_view path) {
  const std::size_t open = pattern.find('{');
  if (open == std::string_view::npos) {
    return path == pattern ? std::optional<std::string>("") : std::nullopt;
  }
  const std::size_t close = pattern.find('}', open);
  const std::string_view before = pattern.substr(0, open), after = pattern.substr(close + 1);
  const bool rest = pattern.substr(0, close).ends_with("...");
  if (path.size() <= before.size() + after.size() || !path.starts_with(before) ||
      !path.ends_with(after)) {
    return std::nullopt;
  }
  const std::string_view parameter =
      path.substr(before.size(), path.size() - before.size() - after.size());
  if (!rest && parameter.find('/') != std::string_view::npos) return std::nullopt;
  return std::string(parameter);
}

bool Takes(const Route& route, std::string_view method) {
  return method == route.method || (method == "HEAD" && std::string_view(route.method) == "GET");
}

/// The row for a request, or the problem and the methods that the path does take.
struct Found {
  const Route* route = nullptr;
  std::string parameter;
  std::string allowed;
  const char* endpoint = "none";
};

bool IsProbe(std::string_view path) {
  return path == "/livez" || path == "/readyz" || path == "/metrics";
}

Found Find(std::string_view method, const std::string& path, bool probes_alone) {
  Found found;
  for (const Route& route : Routes()) {
    if (probes_alone && !IsProbe(route.path)) continue;
    auto parameter = Match(route.path, path);
    if (!parameter) continue;
    found.endpoint = route.path;
    if (Takes(route, method)) {
      found.route = &route;
      found.parameter = *std::move(parameter);
      return found;
    }
    found.allowed += (found.allowed.empty() ? "" : ", ") + std::string(route.method);
    if (std::string_view(route.method) == "GET") found.allowed += ", HEAD";
  }
  return found;
}

/// What tus' clients send through a network that lets only GET and POST pass. Elsewhere the header
/// means nothing.
std::string MethodOf(const Exchange& exchange) {
  const std::string_view sent = exchange.method();
  const bool upload = exchange.target().path.starts_with("/v1/uploads/");
  const std::string meant = upload ? exchange.header("X-HTTP-Method-Override") : std::string();
  return sent == "POST" && !meant.empty() ? meant : std::string(sent);
}

void RespondUnrouted(const Found& found, Exchange& exchange) {
  const std::string& path = exchange.target().path;
  if (found.allowed.empty()) {
    return exchange.RespondProblem(
        ProblemOf(Refusal::kNoSuchPath, "found " + path + "; /openapi.json lists what there is"));
  }
  exchange.RespondProblem(
      ProblemOf(Refusal::kMethod, "found " + std::string(exchange.method()) + " " + path +
                                      ", expected " + found.allowed),
      {{"Allow", found.allowed}});
}

}  // namespace

Routed Dispatch(Service& service, Exchange& exchange) {
  Routed routed;
  const Found found = Find(MethodOf(exchange), exchange.target().path, service.probes_alone());
  routed.endpoint = found.endpoint;
  if (!found.route) {
    RespondUnrouted(found, exchange);
    return routed;
  }
  const Route& route = *found.route;
  if (route.access != Route::Access::kOpen) {
    const Role needed = route.access == Route::Access::kFull ? Role::kFull : Role::kRead;
    const auto caller = service.keys().Check(exchange.header("Authorization"), needed);
    if (!caller) {
      exchange.RespondProblem(caller.error());
      return routed;
    }
    routed.caller = caller->name;
    exchange.SetCaller(*caller);
  }
  std::optional<RequestSlot> slot;
  if (route.counted) {
    auto entered = service.Enter();
    if (!entered) {
      exchange.RespondProblem(entered.error());
      return routed;
    }
    slot.emplace(*std::move(entered));
  }
  route.handle(service, exchange, found.parameter);
  return routed;
}

}  // namespace strata::server
