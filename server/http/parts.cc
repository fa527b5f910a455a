#include "server/http/parts.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "server/http/accept_header.h"
#include "server/service/canonical_options.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {
constexpr std::uint64_t kMostJson = 1 << 20;

/// "application/json" of "Application/JSON ; charset=utf-8".
std::string MediaTypeIn(std::string_view content_type) {
  std::string type(content_type.substr(0, content_type.find_first_of("; \t")));
  std::ranges::transform(type, type.begin(),
                         [](char c) { return c >= 'A' && c <= 'Z' ? c + ('a' - 'A') : c; });
  return type;
}
}  // namespace

void RespondMessage(Exchange& exchange, int status, const google::protobuf::Message& message,
                    const Headers& headers) {
  Headers all = headers;
  all.emplace_back("Content-Type", "application/json");
  all.emplace_back("Cache-Control", "no-store");
  exchange.Respond(status, all, JsonOf(message) + '\n');
}

Answer<void> QueryInto(const RequestTarget& target, google::protobuf::Message& message) {
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [typed, text] : target.query) {
    std::string name = typed;
    std::ranges::replace(name, '-', '_');
    const auto* const field = message.GetDescriptor()->FindFieldByName(name);
    if (!field) {
      return Refuse(Error{ErrorCode::kInvalidArgument, "unknown parameter '" + typed + "'"});
    }
    if (field->is_repeated()) {
      json[name].push_back(text);
    } else if (json.contains(name)) {
      return Refuse(Error{ErrorCode::kInvalidArgument, name + ": given twice, expected once"});
    } else {
      json[name] = text;
    }
  }
  if (auto parsed = FromJson(json.dump(), message); !parsed) return Refuse(parsed.error());
  return {};
}

Answer<void> JsonBodyInto(Exchange& exchange, google::protobuf::Message& message) {
  const std::string type = exchange.header("Content-Type");
  if (MediaTypeIn(type) != "application/json") {
    return Refuse(Refusal::kMediaType,
                  "Content-Type: found '" + type + "', expected application/json");
  }
  std::string body;
  const auto received = exchange.ReadBody(kMostJson, [&body](std::string_view bytes) {
    body += bytes;
    return Answer<void>();
  });
  if (!received) return Pass(received);
  // The message's own parser takes more than JSON (names without quotes, trailing commas).
  if (!nlohmann::json::accept(body)) {
    return Refuse(Refusal::kMalformed, "the body is no valid JSON");
  }
  if (auto parsed = FromJson(body, message); !parsed) {
    return Refuse(Refusal::kMalformed, parsed.error().message);
  }
  return {};
}

Answer<v1::SampleOptions> SampleOptionsOf(
    const Exchange& exchange, const std::vector<std::pair<std::string, std::string>>& query) {
  auto options = OptionsFromTexts(query);
  if (!options) return Refuse(options.error());
  if (!options->has_format()) {
    auto format = FormatForAccept(exchange.header("Accept"));
    if (!format) return Pass(format);
    options->set_format(*std::move(format));
  }
  return *std::move(options);
}

Answer<void> CheckMeshType(const Exchange& exchange) {
  const std::string type = exchange.header("Content-Type");
  const std::string media = MediaTypeIn(type);
  if (media.starts_with("multipart/") || media == "application/json") {
    return Refuse(Refusal::kMediaType, "Content-Type: found '" + type +
                                           "', expected the bytes of a mesh file as the body, "
                                           "such as application/octet-stream");
  }
  const std::string coding = exchange.header("Content-Encoding");
  if (!coding.empty() && coding != "gzip" && coding != "zstd" && coding != "identity") {
    return Refuse(Refusal::kMediaType,
                  "Content-Encoding: found '" + coding + "', expected gzip, zstd or none");
  }
  return {};
}

Headers ResultHeaders(const Sampled& sampled) {
  std::string suffix = "zip";  // Of tiles, in whatever format.
  for (const FormatName& format : Formats()) {
    if (sampled.summary.media_type() == format.media_type) suffix = format.name;
  }
  // On one line and in ASCII, as a header must be.
  const std::string summary =
      nlohmann::ordered_json::parse(sampled.summary.json(), nullptr, false).dump(-1, ' ', true);
  return {{"Content-Disposition", "attachment; filename=\"samples." + suffix + "\""},
          {"Vary", "Accept"},
          {"Strata-Cache", sampled.summary.cached() ? "hit" : "miss"},
          {"Strata-Summary", summary}};
}

Answer<void> CheckNoParameters(const RequestTarget& target) {
  if (target.query.empty()) return {};
  return Refuse(Error{ErrorCode::kInvalidArgument,
                      "unknown parameter '" + target.query.front().first + "', expected none"});
}

std::string TakeFromQuery(std::vector<std::pair<std::string, std::string>>& query,
                          std::string_view name) {
  const auto found = std::ranges::find(
      query, name, [](const auto& pair) -> std::string_view { return pair.first; });
  if (found == query.end()) return {};
  std::string value = std::move(found->second);
  query.erase(found);
  return value;
}

}  // namespace strata::server
