// Arbitrary bytes as a file of any format, packed or not.
#include <cstddef>
#include <cstdint>
#include <string>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::test::DrainTwice(strata::io::OpenMesh(strata::io::MemorySource(std::move(bytes))));
  return 0;
}
