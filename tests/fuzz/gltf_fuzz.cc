// Arbitrary bytes as glTF, text or binary.
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "io/byte_source.h"
#include "io/gltf_reader.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return strata::test::DrainBounded(data, size, [](std::string bytes, const auto& options) {
    return strata::io::OpenGltf(strata::io::MemorySource(std::move(bytes)), options);
  });
}
