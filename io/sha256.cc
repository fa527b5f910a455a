#include "io/sha256.h"

#include <openssl/evp.h>

#include <array>

namespace strata::io {
namespace {

const EVP_MD* MethodOf(DigestKind kind) {
  switch (kind) {
    case DigestKind::kMd5:
      return EVP_md5();
    case DigestKind::kSha1:
      return EVP_sha1();
    default:
      return EVP_sha256();
  }
}

}  // namespace

void Hasher::Free::operator()(evp_md_ctx_st* context) const { EVP_MD_CTX_free(context); }

Hasher::Hasher(DigestKind kind) : context_(EVP_MD_CTX_new()) {
  if (context_ && EVP_DigestInit_ex(context_.get(), MethodOf(kind), nullptr) != 1) context_.reset();
}

void Hasher::Update(std::span<const char> bytes) {
  if (context_ && EVP_DigestUpdate(context_.get(), bytes.data(), bytes.size()) != 1) {
    context_.reset();
  }
}

std::string Hasher::HexDigest() {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest;
  unsigned int size = 0;
  if (!context_ || EVP_DigestFinal_ex(context_.get(), digest.data(), &size) != 1) return {};
  context_.reset();
  std::string hex;
  for (unsigned int i = 0; i < size; ++i) {
    hex += "0123456789abcdef"[digest[i] >> 4];
    hex += "0123456789abcdef"[digest[i] & 15];
  }
  return hex;
}

std::string Sha256Hex(std::span<const char> bytes) {
  Hasher hasher;
  hasher.Update(bytes);
  return hasher.HexDigest();
}

}  // namespace strata::io
