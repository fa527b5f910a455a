// Arbitrary bytes as a ZIP archive with a mesh or a 3MF package.
#include <cstddef>
#include <cstdint>
#include <string>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::MemoryAccount memory(std::uint64_t{256} << 20);
  strata::io::OpenOptions options;
  options.memory = &memory;
  strata::test::DrainTwice(
      strata::io::OpenMesh(strata::io::MemorySource(std::move(bytes), "a.zip"), options));
  return 0;
}
