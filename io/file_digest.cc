#include "io/file_digest.h"

#include <algorithm>
#include <cstdlib>

#include "core/scratch.h"
#include "io/sha256.h"

namespace strata::io {

Result<std::array<std::uint64_t, 4>> FileDigest(const std::string& path) {
  const auto file = OpenForReading(path);
  if (!file) return Forward(file);
  constexpr std::uint64_t kPart = 64 << 10;
  const std::uint64_t size = (*file)->size(), part = std::min(size, kPart);
  std::string bytes = std::to_string(size);
  for (const std::uint64_t offset : {std::uint64_t{0}, (size - part) / 2, size - part}) {
    std::string read(part, 0);
    if (auto done = (*file)->ReadAt(offset, read); !done) return Forward(done);
    bytes += read;
  }
  const std::string hex = Sha256Hex(bytes);
  if (hex.size() != 64) return Fail(ErrorCode::kInternal, "no SHA-256 of " + path);
  std::array<std::uint64_t, 4> digest{};
  for (std::size_t i = 0; i < digest.size(); ++i) {
    digest[i] = std::strtoull(hex.substr(16 * i, 16).c_str(), nullptr, 16);
  }
  return digest;
}

}  // namespace strata::io
