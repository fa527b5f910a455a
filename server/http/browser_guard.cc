#include "server/http/browser_guard.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>
#include <array>
#include <optional>

#include "core/lower_case.h"

namespace strata::server {
namespace {

constexpr std::size_t kMostNameBytes = 253;  // Of DNS.

/// The one way to write an address in digits; nothing for a name.
std::optional<std::string> AddressOf(const std::string& text) {
  std::array<unsigned char, sizeof(in6_addr)> bytes;
  std::array<char, INET6_ADDRSTRLEN> written;
  for (const int family : {AF_INET, AF_INET6}) {
    if (inet_pton(family, text.c_str(), bytes.data()) != 1) continue;
    return inet_ntop(family, bytes.data(), written.data(), written.size());
  }
  return std::nullopt;
}

/// `host` in the form that two ways to write one host share.
std::string Canonical(std::string_view host) {
  if (host.starts_with('[') && host.ends_with(']')) host = host.substr(1, host.size() - 2);
  std::string lower = LowerCase(host);
  if (auto address = AddressOf(lower)) return *std::move(address);
  if (lower.ends_with('.')) lower.pop_back();
  return lower;
}

/// The value of a Host header without the port.
std::string_view WithoutPort(std::string_view host) {
  const std::size_t colon = host.rfind(':');
  const bool inside = colon != host.npos && host.find(']', colon) != host.npos;
  if (colon == host.npos || inside) return host;
  const std::string_view port = host.substr(colon + 1);
  const bool digits = std::ranges::all_of(port, [](char c) { return c >= '0' && c <= '9'; });
  return digits ? host.substr(0, colon) : host;
}

/// Whether a page of `origin` ("http://localhost:8080", or "null") was served by `host`.
bool IsSameHost(std::string_view origin, std::string_view host) {
  const std::size_t scheme = origin.find("://");
  return scheme != origin.npos && LowerCase(origin.substr(scheme + 3)) == LowerCase(host);
}

bool ChangesState(std::string_view method) {
  return method != "GET" && method != "HEAD" && method != "OPTIONS";
}

}  // namespace

BrowserGuard::BrowserGuard(const Options& options)
    : refuse_other_sites_(options.refuse_other_sites),
      refuse_other_hosts_(options.refuse_other_hosts) {
  names_ = {"localhost", "::1"};
  for (const std::string& name : options.names) names_.insert(Canonical(name));
  if (options.address.empty()) return;
  const std::string address = Canonical(options.address);
  any_address_ = address == "0.0.0.0" || address == "::";
  names_.insert(address);
}

bool BrowserGuard::Knows(std::string_view host) const {
  const std::string name = Canonical(WithoutPort(host));
  if (names_.contains(name)) return true;
  const bool in_digits = AddressOf(name).has_value();
  return in_digits && (any_address_ || name.starts_with("127."));
}

Answer<void> BrowserGuard::Check(const Exchange& exchange) const {
  const std::string& absolute = exchange.target().authority;
  const std::string host = absolute.empty() ? exchange.header("Host") : absolute;
  if (refuse_other_hosts_ && !Knows(host)) {
    return Refuse(Refusal::kMisdirected,
                  "Host: found '" + host +
                      "', expected localhost, the address that the service listens on, or a name "
                      "that it was given with --allowed-host");
  }
  if (!refuse_other_sites_ || !ChangesState(exchange.method())) return {};
  const std::string origin = exchange.header("Origin");
  if (!origin.empty() && !IsSameHost(origin, host)) {
    return Refuse(Refusal::kCrossSite,
                  "Origin: found '" + origin + "', expected a page of Host, '" + host + "'");
  }
  if (LowerCase(exchange.header("Sec-Fetch-Site")) == "cross-site") {
    return Refuse(Refusal::kCrossSite, "Sec-Fetch-Site: found cross-site");
  }
  return {};
}

bool IsHostName(std::string_view text) {
  const std::string name = Canonical(text);
  if (AddressOf(name)) return true;
  return !name.empty() && name.size() <= kMostNameBytes && std::ranges::all_of(name, [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || c == '-' || c == '.' || c == '_';
  });
}

}  // namespace strata::server
