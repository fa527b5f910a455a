// Arbitrary bytes as a Draco mesh.
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "io/byte_source.h"
#include "io/drc_reader.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return strata::test::DrainBounded(data, size, [](std::string bytes, const auto& options) {
    return strata::io::OpenDraco(strata::io::MemorySource(std::move(bytes)), options);
  });
}
