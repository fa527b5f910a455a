#include "server/remote/s3_name.h"

#include <utf8cpp/utf8.h>

#include <algorithm>

#include "io/quote.h"

namespace strata::server {
namespace {

constexpr std::string_view kScheme = "s3://";

bool IsAlphanumeric(char c) {
  return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z');
}

void AppendPercent(std::string& out, char c) {
  const auto byte = static_cast<unsigned char>(c);
  out += '%';
  out += "0123456789ABCDEF"[byte >> 4];
  out += "0123456789ABCDEF"[byte & 15];
}

int HexValue(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

/// What every store allows, and the older ones of AWS: the name also becomes part of a host's name.
bool IsBucketName(std::string_view bucket) {
  return bucket.size() >= 3 && bucket.size() <= 63 && IsAlphanumeric(bucket.front()) &&
         IsAlphanumeric(bucket.back()) && bucket.find("..") == std::string_view::npos &&
         std::ranges::all_of(
             bucket, [](char c) { return IsAlphanumeric(c) || c == '-' || c == '.' || c == '_'; });
}

}  // namespace

std::string S3Name::Shown() const {
  const std::string text = bucket + '/' + key;
  const bool is_utf8 = utf8::is_valid(text.begin(), text.end());
  std::string shown(kScheme);
  for (const char c : text) {
    const bool high = static_cast<unsigned char>(c) >= 0x80;
    if (high ? is_utf8 : (c >= ' ' && c != 0x7F)) {
      shown += c;
    } else {
      AppendPercent(shown, c);
    }
  }
  return shown;
}

bool IsS3Url(std::string_view text) { return text.starts_with(kScheme); }

Result<S3Name> ParseS3Url(std::string_view url) {
  if (!IsS3Url(url)) {
    return Fail(ErrorCode::kInvalidArgument,
                io::Quoted(url) + " is not the address of a bucket: expected s3://BUCKET/PREFIX");
  }
  const std::string_view rest = url.substr(kScheme.size());
  const std::size_t slash = std::min(rest.find('/'), rest.size());
  S3Name name{std::string(rest.substr(0, slash)),
              std::string(rest.substr(std::min(slash + 1, rest.size())))};
  if (!IsBucketName(name.bucket)) {
    return Fail(ErrorCode::kInvalidArgument,
                io::Quoted(url) + ": " + io::Quoted(name.bucket) +
                    " is not a bucket's name: expected 3 to 63 letters, digits, '-', '.' or '_'");
  }
  if (name.key.size() > kMaxKeyBytes) {
    return Fail(ErrorCode::kInvalidArgument, io::Quoted(url) + ": a key of " +
                                                 std::to_string(name.key.size()) +
                                                 " bytes, of which 1024 are allowed");
  }
  return name;
}

Result<S3Name> ParseS3Folder(std::string_view url) {
  Result<S3Name> name = ParseS3Url(url);
  if (name && !name->key.empty() && !name->key.ends_with('/')) name->key += '/';
  return name;
}

std::string WhyNotAPath(std::string_view key) {
  if (key.empty()) return "it is empty";
  if (key.find('\0') != std::string_view::npos) return "it holds a NUL";
  if (key.find('\\') != std::string_view::npos) return "it holds a backslash";
  if (!utf8::is_valid(key.begin(), key.end())) return "it is not UTF-8";
  for (std::size_t begin = 0; begin <= key.size();) {
    const std::size_t end = std::min(key.find('/', begin), key.size());
    const std::string_view segment = key.substr(begin, end - begin);
    if (segment.empty()) return "a part of it is empty";
    if (segment == "." || segment == "..") return "a part of it is " + io::Quoted(segment);
    if (segment.size() > 255) return "a part of it is longer than 255 bytes";
    begin = end + 1;
  }
  return {};
}

std::string PercentEncode(std::string_view text, bool keep_slashes) {
  std::string out;
  for (const char c : text) {
    const bool keep = IsAlphanumeric(c) || c == '-' || c == '.' || c == '_' || c == '~' ||
                      (c == '/' && keep_slashes);
    if (keep) {
      out += c;
    } else {
      AppendPercent(out, c);
    }
  }
  return out;
}

Result<std::string> PercentDecode(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      out += text[i] == '+' ? ' ' : text[i];
      continue;
    }
    const int high = i + 2 < text.size() ? HexValue(text[i + 1]) : -1;
    const int low = i + 2 < text.size() ? HexValue(text[i + 2]) : -1;
    if (high < 0 || low < 0) {
      return Fail(ErrorCode::kCorruptInput, "byte " + std::to_string(i) + " of " +
                                                io::Quoted(text) + ": '%' without two hex digits");
    }
    out += static_cast<char>(high * 16 + low);
    i += 2;
  }
  return out;
}

std::string EncodeQuery(const S3Query& query) {
  S3Query encoded;
  for (const auto& [name, value] : query) {
    encoded.emplace_back(PercentEncode(name, false), PercentEncode(value, false));
  }
  std::ranges::sort(encoded);
  std::string out;
  for (const auto& [name, value] : encoded) {
    if (!out.empty()) out += '&';
    out += name + '=' + value;
  }
  return out;
}

}  // namespace strata::server
