// Arbitrary bytes as a PLY file.
#include <cstddef>
#include <cstdint>
#include <string>

#include "io/ply_reader.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::test::DrainTwice(
      strata::io::OpenPly(strata::io::MemorySource(std::move(bytes)), strata::io::OpenOptions{}));
  return 0;
}
