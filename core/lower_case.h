// Letters of ASCII in lower case.
#pragma once

#include <string>
#include <string_view>

namespace strata {

/// `text` with A to Z as a to z, whatever the locale; other bytes as they are.
inline std::string LowerCase(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return lower;
}

}  // namespace strata
