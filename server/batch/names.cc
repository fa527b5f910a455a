#include "server/batch/names.h"

#include <utf8cpp/utf8.h>

#include <charconv>
#include <iterator>

namespace strata::server {
namespace {

constexpr const char* kDigits = "0123456789abcdef";

std::string Hex(std::string_view bytes) {
  std::string text;
  for (const char c : bytes) {
    text += kDigits[static_cast<unsigned char>(c) >> 4];
    text += kDigits[static_cast<unsigned char>(c) & 15];
  }
  return text;
}

std::string FromHex(std::string_view text) {
  std::string bytes;
  for (std::size_t i = 0; i + 1 < text.size(); i += 2) {
    unsigned value = 0;
    std::from_chars(text.data() + i, text.data() + i + 2, value, 16);
    bytes += static_cast<char>(value);
  }
  return bytes;
}

std::string Escaped(unsigned char byte) {
  if (byte == '\n') return "\\n";
  if (byte == '\t') return "\\t";
  return std::string("\\x") + kDigits[byte >> 4] + kDigits[byte & 15];
}

}  // namespace

std::string Printable(std::string_view bytes) {
  std::string text;
  for (auto at = bytes.begin(); at != bytes.end();) {
    auto next = at;
    std::uint32_t code = 0;
    try {
      code = utf8::next(next, bytes.end());
    } catch (const utf8::exception&) {
      next = at;
    }
    const bool control =
        code < 0x20 || (code >= 0x7f && code < 0xa0) || code == 0x2028 || code == 0x2029;
    if (next != at && !control) {
      text.append(at, next);
      at = next;
    } else {
      for (const auto end = next == at ? std::next(at) : next; at != end; ++at) {
        text += Escaped(static_cast<unsigned char>(*at));
      }
    }
  }
  return text;
}

std::string_view WithoutPath(std::string_view message, std::string_view path) {
  const bool named = message.starts_with(path) && message.substr(path.size()).starts_with(": ");
  return named ? message.substr(path.size() + 2) : message;
}

std::string AsUtf8(std::string_view bytes) {
  std::string text;
  utf8::replace_invalid(bytes.begin(), bytes.end(), std::back_inserter(text));
  return text;
}

void PutName(nlohmann::ordered_json& json, const std::string& key, std::string_view name) {
  json[key] = AsUtf8(name);
  if (!utf8::is_valid(name.begin(), name.end())) json[key + "_hex"] = Hex(name);
}

std::string GetName(const nlohmann::ordered_json& json, const std::string& key) {
  const auto hex = json.find(key + "_hex");
  if (hex != json.end()) return FromHex(hex->get<std::string>());
  const auto text = json.find(key);
  return text == json.end() ? std::string() : text->get<std::string>();
}

}  // namespace strata::server
