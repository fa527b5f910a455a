// How objects in S3-compatible stores are named: s3:// addresses, and their form in requests.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// An object, or the common beginning (prefix) of several, in a bucket. A key is any bytes, chosen
/// by whoever wrote the object: never a path.
struct S3Name {
  std::string bucket;
  std::string key;  ///< At most 1024 bytes; may be empty where a prefix is meant.

  /// "s3://bucket/key" for messages: control characters and what is not UTF-8 as %XX.
  std::string Shown() const;
};

/// The most bytes a key may have.
inline constexpr std::size_t kMaxKeyBytes = 1024;

/// Whether `text` begins as an address of a bucket does: "s3://".
bool IsS3Url(std::string_view text);

/// "s3://bucket", "s3://bucket/" or "s3://bucket/any/key". The key is taken as it stands, without
/// decoding. Errors: kInvalidArgument (no such form, a bucket's name that no store allows, a key
/// that is too long).
Result<S3Name> ParseS3Url(std::string_view url);

/// The same for what lies below: a key that is not empty gets a '/' at its end.
Result<S3Name> ParseS3Folder(std::string_view url);

/// Why `key` cannot be mirrored as a path below a folder, or empty: it begins or ends with '/', has
/// an empty, "." or ".." segment, a segment above 255 bytes, a NUL or backslash, or is no UTF-8.
std::string WhyNotAPath(std::string_view key);

/// Percent-encodes as the signature wants it: all but letters, digits and "-._~" as %XX in
/// capitals;
/// '/' stays if `keep_slashes`.
std::string PercentEncode(std::string_view text, bool keep_slashes);
/// Undoes it; '+' becomes a space, as stores write one in listings. Errors: kCorruptInput.
Result<std::string> PercentDecode(std::string_view text);

/// Names and values of a query, not encoded.
using S3Query = std::vector<std::pair<std::string, std::string>>;
/// "a=1&b=" in the order of the signature: sorted by encoded name. Empty for none.
std::string EncodeQuery(const S3Query& query);

}  // namespace strata::server
