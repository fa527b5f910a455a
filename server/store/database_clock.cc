#include "server/store/database_clock.h"

#include <chrono>

namespace strata::server {
namespace {

std::int64_t MonotonicMillis() {
  const auto now = std::chrono::steady_clock::now().time_since_epoch();
  return std::chrono::duration_cast<Milliseconds>(now).count();
}

}  // namespace

DatabaseClock::DatabaseClock(Database& database)
    : database_(database), ahead_millis_(ToMillis(SystemClock().Now()) - MonotonicMillis()) {}

Result<void> DatabaseClock::Refresh() {
  const auto now = database_.Read().Now();
  if (!now) return Forward(now);
  ahead_millis_ = ToMillis(*now) - MonotonicMillis();
  return {};
}

Timestamp DatabaseClock::Now() const { return FromMillis(MonotonicMillis() + ahead_millis_); }

}  // namespace strata::server
