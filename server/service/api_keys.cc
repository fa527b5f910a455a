#include "server/service/api_keys.h"

#include <sys/random.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <sstream>

#include "io/sha256.h"

namespace strata::server {
namespace {

constexpr std::size_t kKeyBytes = 32, kMostNameBytes = 64;

bool IsHex(std::string_view text) {
  return std::ranges::all_of(
      text, [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

bool IsName(std::string_view text) {
  return !text.empty() && text.size() <= kMostNameBytes && std::ranges::all_of(text, [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
           std::string_view("-_.@").find(c) != std::string_view::npos;
  });
}

/// Without a branch on the bytes, so that the time says nothing of how many are right.
bool SameHash(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  unsigned differ = 0;
  for (std::size_t i = 0; i < a.size(); ++i) differ |= static_cast<unsigned>(a[i] ^ b[i]);
  return differ == 0;
}

std::string_view KeyOf(std::string_view authorization) {
  constexpr std::string_view kScheme = "bearer ";
  if (authorization.size() <= kScheme.size()) return {};
  for (std::size_t i = 0; i < kScheme.size(); ++i) {
    const char c = authorization[i];
    if ((c >= 'A' && c <= 'Z' ? c + 32 : c) != kScheme[i]) return {};
  }
  return authorization.substr(kScheme.size());
}

}  // namespace

Result<ApiKeys> ApiKeys::Load(const std::string& path) {
  std::ifstream file(path);
  if (!file) return Fail(ErrorCode::kNotFound, path + ": cannot be opened");
  ApiKeys keys;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    std::istringstream words(line);
    std::string hash, role, name, more;
    words >> hash >> role >> name >> more;
    if (hash.empty() || hash.starts_with('#')) continue;
    const bool good = hash.size() == 64 && IsHex(hash) && (role == "full" || role == "read") &&
                      IsName(name) && more.empty();
    if (!good) {
      return Fail(ErrorCode::kInvalidArgument,
                  path + ", line " + std::to_string(number) +
                      ": expected 64 hex digits, full or read, and a name; `strata key NAME` "
                      "prints such a line");
    }
    keys.rows_.push_back({hash, {name, role == "full" ? Role::kFull : Role::kRead}});
  }
  if (file.bad()) return Fail(ErrorCode::kIo, path + ": cannot be read");
  if (keys.empty()) return Fail(ErrorCode::kInvalidArgument, path + ": holds no key");
  return keys;
}

Answer<Caller> ApiKeys::Check(std::string_view authorization, Role needed) const {
  if (empty()) return Caller{};
  const std::string_view key = KeyOf(authorization);
  const std::string hash = io::Sha256Hex(key);
  const Caller* found = nullptr;
  for (const Row& row : rows_) {
    if (SameHash(row.hash, hash)) found = &row.caller;
  }
  if (!found || key.empty()) {
    return Refuse(Refusal::kUnauthenticated, authorization.empty()
                                                 ? "send the header 'Authorization: Bearer KEY'"
                                                 : "the key in 'Authorization' is not known");
  }
  if (needed == Role::kFull && found->role == Role::kRead) {
    return Refuse(Refusal::kForbidden, "the key '" + found->name + "' may only read");
  }
  return *found;
}

Result<NewKey> MakeKey(const std::string& name, Role role) {
  if (!IsName(name)) {
    return Fail(ErrorCode::kInvalidArgument,
                "NAME: found '" + name + "', expected 1 to 64 letters, digits, - _ . @");
  }
  std::array<unsigned char, kKeyBytes> random;
  if (getrandom(random.data(), random.size(), 0) != static_cast<ssize_t>(random.size())) {
    return Fail(ErrorCode::kIo, "the system gives no random bytes");
  }
  constexpr std::string_view kDigits = "0123456789abcdef";
  NewKey made;
  made.key = "strata_";
  for (const unsigned char byte : random) {
    made.key += kDigits[byte >> 4];
    made.key += kDigits[byte & 15];
  }
  made.line = io::Sha256Hex(made.key) + (role == Role::kFull ? " full " : " read ") + name;
  return made;
}

}  // namespace strata::server
