// Keeps the pages of other sites out of a service that asks for no key.
#pragma once

#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "server/http/exchange.h"

namespace strata::server {

/// A browser carries the requests of any page to any address it reaches, loopback included. Without
/// a key nothing tells them from their user's own, but two headers that a page cannot choose:
/// `Host` betrays a stranger's name that was made to point here (DNS rebinding), `Origin` and
/// `Sec-Fetch-Site` a page from elsewhere (cross-site request forgery). Threads: any, once made.
class BrowserGuard {
 public:
  struct Options {
    /// Off where another page cannot know what lets a request in (a key).
    bool refuse_other_sites = true;
    /// Off where that holds, or where TLS has checked the name (a client's certificate is asked
    /// for).
    bool refuse_other_hosts = true;
    std::string address;             ///< It listens on this one: IPv4 or IPv6; empty: none.
    std::vector<std::string> names;  ///< Further ones, as IsHostName takes them.
  };

  /// Loopback's names alone.
  BrowserGuard() : BrowserGuard(Options{}) {}
  explicit BrowserGuard(const Options& options);

  /// Refuses: kMisdirected unless `Host`, whatever its port, is localhost, in 127.0.0.0/8, ::1, the
  /// address or one of the names (of 0.0.0.0 and ::, any address in digits: no DNS is asked for
  /// it); kCrossSite for a method other than GET, HEAD and OPTIONS from a page that `Host` did not
  /// serve.
  Answer<void> Check(const Exchange& exchange) const;

 private:
  bool Knows(std::string_view host) const;

  bool refuse_other_sites_, refuse_other_hosts_, any_address_ = false;
  std::set<std::string> names_;
};

/// Whether `text` is a host's name or address, without a port; IPv6 with or without brackets.
bool IsHostName(std::string_view text);

}  // namespace strata::server
