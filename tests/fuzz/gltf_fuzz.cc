// Arbitrary bytes as glTF, text or binary.
#include <cstddef>
#include <cstdint>
#include <string>

#include "io/byte_source.h"
#include "io/gltf_reader.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::MemoryAccount memory(std::uint64_t{256} << 20);
  strata::io::OpenOptions options;
  options.memory = &memory;
  strata::test::DrainTwice(
      strata::io::OpenGltf(strata::io::MemorySource(std::move(bytes)), options));
  return 0;
}
