#include "server/http/request_target.h"

#include <algorithm>
#include <optional>

namespace strata::server {
namespace {

std::optional<int> HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return std::nullopt;
}

Answer<std::string> Decode(std::string_view text) {
  std::string decoded;
  for (std::size_t i = 0; i < text.size(); ++i) {
    char c = text[i];
    if (c == '%') {
      const auto high = i + 2 < text.size() ? HexDigit(text[i + 1]) : std::nullopt;
      const auto low = i + 2 < text.size() ? HexDigit(text[i + 2]) : std::nullopt;
      if (!high || !low) {
        return Refuse(Refusal::kMalformed, "the URL: found '%' at byte " + std::to_string(i) +
                                               " of '" + std::string(text) +
                                               "', expected two hex digits after it");
      }
      c = static_cast<char>(*high * 16 + *low);
      i += 2;
    }
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      return Refuse(Refusal::kMalformed, "the URL: found a control character, expected none");
    }
    decoded += c;
  }
  if (ValidUtf8(decoded) != decoded) {
    return Refuse(Refusal::kMalformed, "the URL: found bytes that are not UTF-8");
  }
  return decoded;
}

}  // namespace

Answer<RequestTarget> ParseTarget(std::string_view target) {
  RequestTarget parsed;
  if (target.starts_with("http://") || target.starts_with("https://")) {
    target.remove_prefix(target.find("//") + 2);
    const std::size_t end = std::min(target.find_first_of("/?"), target.size());
    if (end == 0) return Refuse(Refusal::kMalformed, "the URL: found no host after '//'");
    parsed.authority = target.substr(0, end);
    target.remove_prefix(end);
    if (target.empty()) target = "/";
  }
  if (!target.starts_with('/')) {
    return Refuse(Refusal::kMalformed, "the URL: expected a path that begins with '/'");
  }
  const std::size_t mark = std::min(target.find('?'), target.size());
  auto path = Decode(target.substr(0, mark));
  if (!path) return Pass(path);
  parsed.path = *std::move(path);
  std::string_view rest = mark < target.size() ? target.substr(mark + 1) : std::string_view();
  while (!rest.empty()) {
    const std::size_t end = std::min(rest.find('&'), rest.size());
    const std::string_view pair = rest.substr(0, end);
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (pair.empty()) continue;
    const std::size_t equals = std::min(pair.find('='), pair.size());
    auto name = Decode(pair.substr(0, equals));
    auto value = Decode(pair.substr(std::min(equals + 1, pair.size())));
    if (!name) return Pass(name);
    if (!value) return Pass(value);
    parsed.query.emplace_back(*std::move(name), *std::move(value));
  }
  return parsed;
}

}  // namespace strata::server
