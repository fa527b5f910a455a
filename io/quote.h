// Putting what was found in a file into a message.
#pragma once

#include <string>
#include <string_view>

namespace strata::io {

/// `found` between quotes, cut to 40 bytes, what is not printable ASCII replaced by '?'.
inline std::string Quoted(std::string_view found) {
  std::string text(1, '\'');
  for (const char c : found.substr(0, 40)) text += c >= ' ' && c <= '~' ? c : '?';
  if (found.size() > 40) text += "...";
  return text + '\'';
}

}  // namespace strata::io
