// Names of files, which are bytes, in texts.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace strata::server {

/// For a line on a terminal: bytes that are no UTF-8, and control characters, as "\n" or "\xNN".
std::string Printable(std::string_view bytes);

/// A message about the file `path` without the path that it begins with, for where that stands
/// already.
std::string_view WithoutPath(std::string_view message, std::string_view path);

/// The bytes as UTF-8: what is none becomes U+FFFD.
std::string AsUtf8(std::string_view bytes);

/// Puts a name into an object under `key`. One that is no UTF-8 stands there as AsUtf8 shows it,
/// and under "KEY_hex" as it is.
void PutName(nlohmann::ordered_json& json, const std::string& key, std::string_view name);
/// The name that PutName put there; empty if none was. Throws nlohmann::json::exception.
std::string GetName(const nlohmann::ordered_json& json, const std::string& key);

}  // namespace strata::server
