// Arbitrary bytes as an image: its head from every part of the front that may be asked for, and the
// pixels, looked up here and there.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/memory_account.h"
#include "io/image.h"
#include "io/texture_sampler.h"
#include "tests/fuzz/drain.h"

using strata::test::Require;

namespace {

template <class T>
bool IsAnswer(const strata::Result<T>& result) {
  return result ||
         (!result.error().message.empty() && result.error().code != strata::ErrorCode::kInternal);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span<const char> bytes(reinterpret_cast<const char*>(data), size);
  for (const std::size_t n : {size / 4, size / 2}) {
    Require(IsAnswer(strata::io::ReadImageHead(bytes.first(n), size, "front")));
  }
  strata::MemoryAccount memory(std::uint64_t{16} << 20);
  {
    const auto image = strata::io::DecodeImage(bytes, "image", &memory);
    Require(IsAnswer(image));
    if (image) {
      Require(memory.taken() == image->head().pixel_bytes());
      for (const auto wrap : {strata::io::Wrap::kRepeat, strata::io::Wrap::kMirror}) {
        for (const double at : {-1e9, -0.3, 0.0, 0.5, 1.0, 7.25}) {
          for (const double value :
               strata::io::LookUp(*image, {wrap, wrap, at > 0.7}, at, 1 - at)) {
            Require(value >= 0 && value <= 1 + 1e-9);
          }
        }
      }
    }
  }
  Require(memory.taken() == 0);
  return 0;
}
