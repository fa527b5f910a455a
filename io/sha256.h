// SHA-256 (SHA-1 and MD5, which the tus and S3 protocols ask for) of bytes in memory or as they
// pass by.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

struct evp_md_ctx_st;

namespace strata::io {

/// 64 hex digits, lower case; empty if the library refuses (out of memory).
std::string Sha256Hex(std::span<const char> bytes);

enum class DigestKind : std::uint8_t { kMd5, kSha1, kSha256 };

/// A digest of a stream. Threads: one at a time. Movable; a moved-from one may only be destroyed.
class Hasher {
 public:
  explicit Hasher(DigestKind kind = DigestKind::kSha256);
  void Update(std::span<const char> bytes);
  /// Lower-case hex digits of everything passed to Update; empty if the library refused at any
  /// point (out of memory). Once, after which the object is spent.
  std::string HexDigest();

 private:
  struct Free {
    void operator()(evp_md_ctx_st* context) const;
  };
  std::unique_ptr<evp_md_ctx_st, Free> context_;  // Null after a refusal.
};

}  // namespace strata::io
