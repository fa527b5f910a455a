#include "core/packing.h"

#include <zstd.h>

#include <memory>

namespace strata {

Result<std::string> Seal(std::string_view packed) {
  std::string sealed(ZSTD_compressBound(packed.size()), 0);
  const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> zstd(ZSTD_createCCtx(), ZSTD_freeCCtx);
  ZSTD_CCtx_setParameter(zstd.get(), ZSTD_c_checksumFlag, 1);
  const std::size_t n =
      ZSTD_compress2(zstd.get(), sealed.data(), sealed.size(), packed.data(), packed.size());
  if (ZSTD_isError(n)) return Fail(ErrorCode::kInternal, "a record does not pack");
  sealed.resize(n);
  return sealed;
}

std::string Unseal(std::string_view sealed, std::size_t size) {
  std::string packed(size, 0);
  const std::size_t n = ZSTD_decompress(packed.data(), size, sealed.data(), sealed.size());
  return ZSTD_isError(n) || n != size ? std::string() : packed;
}

}  // namespace strata
