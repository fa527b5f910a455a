#include "server/service/request_id.h"

#include <sys/random.h>

#include <algorithm>
#include <array>
#include <string_view>

namespace strata::server {
namespace {

bool IsHexDigit(char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); }

bool IsRequestId(std::string_view text) {
  return !text.empty() && text.size() <= 64 && std::ranges::all_of(text, [](char c) {
    return IsHexDigit(c) || (c >= 'g' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
           std::string_view("-_.").find(c) != std::string_view::npos;
  });
}

}  // namespace

std::string RequestIdOf(const std::string& asked) {
  if (IsRequestId(asked)) return asked;
  std::array<unsigned char, 8> random{};
  static_cast<void>(getrandom(random.data(), random.size(), 0));
  std::string id;
  for (const unsigned char byte : random) {
    id += "0123456789abcdef"[byte >> 4];
    id += "0123456789abcdef"[byte & 15];
  }
  return id;
}

std::string TraceParentOf(const std::string& text) {
  constexpr std::string_view kShape = "00-hhhhhhhhhhhhhhhhhhhhhhhhhhhhhhhh-hhhhhhhhhhhhhhhh-hh";
  if (text.size() != kShape.size()) return {};
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (kShape[i] == 'h' ? !IsHexDigit(text[i]) : text[i] != kShape[i]) return {};
  }
  return text;
}

}  // namespace strata::server
