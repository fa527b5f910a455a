#include "server/service/log.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>

namespace strata::server {
namespace {

using Json = nlohmann::ordered_json;

struct Sink {
  LogFormat format = LogFormat::kText;
  std::shared_ptr<spdlog::logger> logger;
};

Sink& TheSink() {
  static Sink sink = {LogFormat::kText,
                      std::make_shared<spdlog::logger>(
                          "strata", std::make_shared<spdlog::sinks::stderr_sink_mt>())};
  return sink;
}

spdlog::level::level_enum LevelOf(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      break;
  }
  return spdlog::level::err;
}

std::string Dump(const Json& json) {
  return json.dump(-1, ' ', true, Json::error_handler_t::replace);
}

Json ToJson(const LogField& field) {
  return std::visit([](const auto& value) { return Json(value); }, field.value);
}

/// Nothing to say: an empty text.
bool IsEmpty(const LogField& field) {
  const auto* const text = std::get_if<std::string>(&field.value);
  return text && text->empty();
}

/// A word as it is, anything else as a JSON string.
std::string InText(const Json& value) {
  const std::string quoted = Dump(value);
  if (!value.is_string()) return quoted;
  const bool word = !quoted.empty() && quoted.find_first_of(" =\\") == std::string::npos &&
                    quoted.find('"', 1) == quoted.size() - 1 && quoted.size() > 2;
  return word ? quoted.substr(1, quoted.size() - 2) : quoted;
}

}  // namespace

void StartLog(LogFormat format, LogLevel least) {
  Sink& sink = TheSink();
  sink.format = format;
  sink.logger->set_level(LevelOf(least));
  sink.logger->flush_on(spdlog::level::debug);
  // JSON is put together below, the instant included, in UTC.
  sink.logger->set_pattern(format == LogFormat::kJson
                               ? R"({"time":"%Y-%m-%dT%H:%M:%S.%fZ","level":"%l",%v})"
                               : "%Y-%m-%dT%H:%M:%S.%fZ %l %v",
                           spdlog::pattern_time_type::utc);
}

void Log(LogLevel level, std::string_view event, std::initializer_list<LogField> fields) {
  const Sink& sink = TheSink();
  if (!sink.logger->should_log(LevelOf(level))) return;
  std::string line;
  if (sink.format == LogFormat::kJson) {
    Json json = {{"event", event}};
    for (const LogField& field : fields) {
      if (!IsEmpty(field)) json[field.name] = ToJson(field);
    }
    const std::string text = Dump(json);
    line = text.substr(1, text.size() - 2);
  } else {
    line = event;
    for (const LogField& field : fields) {
      if (IsEmpty(field)) continue;
      line += std::string(" ") + field.name + '=' + InText(ToJson(field));
    }
  }
  sink.logger->log(LevelOf(level), "{}", line);
}

}  // namespace strata::server
