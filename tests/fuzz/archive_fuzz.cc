// Arbitrary bytes as a ZIP archive with a mesh or a 3MF package.
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return strata::test::DrainBounded(data, size, [](std::string bytes, const auto& options) {
    return strata::io::OpenMesh(strata::io::MemorySource(std::move(bytes), "a.zip"), options);
  });
}
