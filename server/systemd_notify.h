// Tells the service manager what systemd's Type=notify waits for, without its library.
#pragma once

#include <string_view>

namespace strata::server {

/// Sends `state`, such as "READY=1", to the socket that NOTIFY_SOCKET names (sd_notify(3)). Where
/// there is none, or it does not take it, nothing happens: a service does not depend on being
/// watched.
void NotifySystemd(std::string_view state);

}  // namespace strata::server
