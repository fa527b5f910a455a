// The service's log: one line an event, to standard error.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

namespace strata::server {

enum class LogFormat { kText, kJson };
enum class LogLevel { kDebug, kInfo, kWarning, kError };

/// A named value of an event. Never a secret, never a body.
struct LogField {
  const char* name;
  std::variant<std::string, std::uint64_t, double> value;
};

/// Before the first event, from one thread. Events below `least` are dropped.
void StartLog(LogFormat format, LogLevel least);

/// Writes one event with its instant. In both formats a value cannot end its line: control
/// characters are escaped. Threads: any.
void Log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields = {});

}  // namespace strata::server
