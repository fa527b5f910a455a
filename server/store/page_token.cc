#include "server/store/page_token.h"

#include "io/quote.h"
#include "server/store/file.h"

namespace strata::server {

std::string MakePageToken(char kind, std::string_view last) {
  std::string token(1, kind);
  for (const char c : last) {
    const auto byte = static_cast<unsigned char>(c);
    token += "0123456789abcdef"[byte >> 4];
    token += "0123456789abcdef"[byte & 15];
  }
  return token;
}

Result<std::string> ReadPageToken(char kind, std::string_view token) {
  if (token.empty()) return std::string();
  const std::string_view digits = token.substr(1);
  if (token[0] != kind || digits.empty() || digits.size() % 2 != 0 ||
      !IsHex(digits, digits.size())) {
    return Fail(ErrorCode::kInvalidArgument,
                "page token " + io::Quoted(token) + ": not one that this list has given out");
  }
  const auto value = [](char c) { return c <= '9' ? c - '0' : c - 'a' + 10; };
  std::string last;
  for (std::size_t i = 0; i < digits.size(); i += 2) {
    last += static_cast<char>(value(digits[i]) << 4 | value(digits[i + 1]));
  }
  return last;
}

Result<void> CheckPageSize(std::size_t size) {
  if (size >= 1 && size <= kMaxPageSize) return {};
  return Fail(ErrorCode::kInvalidArgument, "page size " + std::to_string(size) +
                                               ": expected 1 to " + std::to_string(kMaxPageSize));
}

}  // namespace strata::server
