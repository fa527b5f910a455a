#include "server/store/model_name.h"

#include <utf8cpp/utf8.h>

#include <string>

#include "io/quote.h"

namespace strata::server {
namespace {

tl::unexpected<Error> Refuse(std::string_view name, std::size_t byte, const std::string& why) {
  return Fail(ErrorCode::kInvalidArgument,
              "model name " + io::Quoted(name) + ": byte " + std::to_string(byte) + ": " + why);
}

bool IsControl(char32_t c) {
  return c < 0x20 || (c >= 0x7f && c < 0xa0) || c == 0x2028 || c == 0x2029;
}

Result<void> CheckCharacters(std::string_view name) {
  for (const char* at = name.data(); at != name.data() + name.size();) {
    const auto byte = static_cast<std::size_t>(at - name.data());
    char32_t c = 0;
    try {
      c = utf8::next(at, name.data() + name.size());
    } catch (const utf8::exception&) {
      return Refuse(name, byte, "not UTF-8");
    }
    if (IsControl(c)) return Refuse(name, byte, "a control character");
    if (c == '\\') return Refuse(name, byte, "a backslash; segments are divided by '/'");
  }
  return {};
}

Result<void> CheckSegment(std::string_view name, std::size_t begin, std::size_t end) {
  if (begin == end) return Refuse(name, begin, "an empty segment");
  if (name[begin] == '.') return Refuse(name, begin, "a segment that begins with a dot");
  return {};
}

}  // namespace

Result<void> CheckModelName(std::string_view name) {
  if (name.empty()) return Refuse(name, 0, "empty");
  if (name.size() > kMaxModelNameBytes) {
    return Refuse(name, kMaxModelNameBytes,
                  std::to_string(name.size()) + " bytes, expected at most " +
                      std::to_string(kMaxModelNameBytes));
  }
  if (auto checked = CheckCharacters(name); !checked) return checked;
  for (std::size_t begin = 0; begin <= name.size();) {
    const std::size_t end = std::min(name.find('/', begin), name.size());
    if (auto checked = CheckSegment(name, begin, end); !checked) return checked;
    begin = end + 1;
  }
  return {};
}

}  // namespace strata::server
