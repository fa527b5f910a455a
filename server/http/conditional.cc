#include "server/http/conditional.h"

#include <charconv>
#include <optional>

namespace strata::server {
namespace {

struct ByteRange {
  std::uint64_t first = 0, size = 0;
};

std::optional<std::uint64_t> NumberOf(std::string_view text) {
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

/// Nothing: no range, or none this takes; size 0: beyond the end.
std::optional<ByteRange> ParseRange(std::string_view text, std::uint64_t size) {
  constexpr std::string_view kUnit = "bytes=";
  if (!text.starts_with(kUnit) || text.find(',') != text.npos) return std::nullopt;
  text.remove_prefix(kUnit.size());
  const std::size_t dash = text.find('-');
  if (dash == text.npos) return std::nullopt;
  const auto first = NumberOf(text.substr(0, dash)), last = NumberOf(text.substr(dash + 1));
  if (dash == 0) {  // The last so many.
    if (!last) return std::nullopt;
    const std::uint64_t count = std::min(*last, size);
    return ByteRange{size - count, count};
  }
  const bool open_end = dash + 1 == text.size();
  if (!first || (!last && !open_end) || (last && *last < *first)) return std::nullopt;
  if (*first >= size) return ByteRange{size, 0};
  const std::uint64_t end = open_end ? size : std::min(*last, size - 1) + 1;
  return ByteRange{*first, end - *first};
}

}  // namespace

bool HasTag(const std::string& list, const std::string& tag, TagMatch match) {
  if (list == "*") return true;
  for (std::size_t at = 0; (at = list.find(tag, at)) != std::string::npos; at += tag.size()) {
    if (match == TagMatch::kWeak || at < 2 || list.compare(at - 2, 2, "W/") != 0) return true;
  }
  return false;
}

void RespondConditional(Exchange& exchange, const Content& content, Headers headers) {
  const bool tagged =
      !content.etag.empty();  // What still grows has no tag, and holds no condition.
  if (tagged) headers.emplace_back("ETag", content.etag);
  const std::string match = tagged ? exchange.header("If-Match") : "";
  if (!match.empty() && !HasTag(match, content.etag, TagMatch::kStrong)) {
    return exchange.RespondProblem(
        ProblemOf(Refusal::kPrecondition, "If-Match: the entity tag is " + content.etag));
  }
  const std::string none_match = tagged ? exchange.header("If-None-Match") : "";
  if (!none_match.empty() && HasTag(none_match, content.etag, TagMatch::kWeak)) {
    return exchange.Respond(304, headers, "");
  }
  headers.emplace_back("Content-Type", content.media_type);
  headers.emplace_back("Accept-Ranges", "bytes");
  const std::string condition = exchange.header("If-Range");
  std::optional<ByteRange> range;
  const bool fits = condition.empty() || (tagged && condition == content.etag);
  if (fits && exchange.method() == "GET") {  // No other method has ranges.
    range = ParseRange(exchange.header("Range"), content.size);
  }
  if (!range) return exchange.RespondContent(200, headers, content, 0, content.size);
  const std::string of = "/" + std::to_string(content.size);
  if (range->size == 0) {
    return exchange.RespondProblem(
        ProblemOf(Refusal::kRange, "there are " + std::to_string(content.size) + " bytes"),
        {{"Content-Range", "bytes *" + of}});
  }
  headers.emplace_back("Content-Range", "bytes " + std::to_string(range->first) + "-" +
                                            std::to_string(range->first + range->size - 1) + of);
  exchange.RespondContent(206, headers, content, range->first, range->size);
}

}  // namespace strata::server
