// The stores' database over PostgreSQL: for several processes, on one machine or many.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include "core/result.h"
#include "server/store/clock.h"
#include "server/store/database.h"

namespace strata::server {

struct PostgresOptions {
  std::string url;       ///< postgresql://[user@]host[:port]/database, or libpq's keywords.
  std::string password;  ///< "": the URL's, or libpq's own ways (PGPASSFILE, PGPASSWORD).
  std::string schema =
      "strata";                 ///< The tables' schema, made if it is missing. Letters and digits.
  std::size_t connections = 8;  ///< At a time, besides the one that listens.
  /// Null: the database's clock. A test's own otherwise; outlives the database.
  const Clock* clock = nullptr;
};

/// Connects once to check that it can. Later every call finds its way back to a database that was
/// away; meanwhile calls fail at once (IsDatabaseAway), and attempts to connect come ever more
/// seldom, at most 5 s apart. A message never holds the password.
/// Errors: kInvalidArgument (the URL); IsDatabaseAway (refused, not there, wrong password).
Result<std::unique_ptr<Database>> OpenPostgres(const PostgresOptions& options);

}  // namespace strata::server
