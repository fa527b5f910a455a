// The viewer: the page at `/` and what it loads.
#pragma once

#include "server/http/exchange.h"

namespace strata::server {

/// Answers GET of the target's path with the file of server/viewer/dist that it names ("/" is the
/// page), as RespondConditional does. Refuses: kNoSuchPath.
void RespondViewerFile(Exchange& exchange);

}  // namespace strata::server
