// A report as a page that needs nothing beside itself.
#pragma once

#include <string>

#include "server/batch/report.h"

namespace strata::server {

/// HTML: totals, failures by reason, plots, pictures, and a table that sorts. Holds no address of
/// anything outside, and a policy (CSP) by which a browser would load none; names and messages are
/// texts, whatever they hold. Bounded: 120 pictures of at most 16 MiB, 20,000 rows (the failed ones
/// first), 4,000 points in a plot; the page says what it leaves out. Pictures that are missing are
/// left out.
std::string ReportPage(const Report& report);

}  // namespace strata::server
