// The database's clock, for what all processes of a shared store have to agree on.
#pragma once

#include <atomic>
#include <cstdint>

#include "core/result.h"
#include "server/store/clock.h"
#include "server/store/database.h"

namespace strata::server {

/// Machines' clocks may differ by hours; by whose clock would an upload expire? By the database's:
/// asked now and then, and counted on by this machine's monotonic clock between. Threads: any.
class DatabaseClock final : public Clock {
 public:
  /// Until Refresh has succeeded once, this machine's clock. `database` must outlive it.
  explicit DatabaseClock(Database& database);

  /// Asks the database. Errors: those of Session::Now; then it goes on as it went.
  Result<void> Refresh();
  /// Never asks the database: the caller may be in the middle of a transaction.
  Timestamp Now() const override;

 private:
  Database& database_;
  std::atomic<std::int64_t> ahead_millis_;  // Of the monotonic clock.
};

}  // namespace strata::server
