// Base64 (RFC 4648, 4) as headers carry it.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace strata::server {

/// The bytes; nothing for a text that is no base64 with its padding.
std::optional<std::string> DecodeBase64(std::string_view text);

}  // namespace strata::server
