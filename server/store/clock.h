// Where the stores take the time from.
#pragma once

#include <chrono>
#include <cstdint>

namespace strata::server {

using Milliseconds = std::chrono::milliseconds;
/// Milliseconds since 1970 in UTC.
using Timestamp = std::chrono::sys_time<Milliseconds>;

/// Tells the time; a test moves its own. Threads: any.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual Timestamp Now() const = 0;
};

/// The machine's clock. It may step back; the stores compare times, they never subtract them
/// unsigned.
class SystemClock final : public Clock {
 public:
  Timestamp Now() const override {
    return std::chrono::floor<Milliseconds>(std::chrono::system_clock::now());
  }
};

/// As the database keeps it.
inline std::int64_t ToMillis(Timestamp time) { return time.time_since_epoch().count(); }
inline Timestamp FromMillis(std::int64_t millis) { return Timestamp(Milliseconds(millis)); }

}  // namespace strata::server
