// Arbitrary bytes as the model of a 3MF package, of which everything around it is sound.
#include <cstddef>
#include <cstdint>
#include <string>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/fuzz/drain.h"
#include "tests/support/zip_maker.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return strata::test::DrainBounded(data, size, [](const std::string& model, const auto& options) {
    const std::string package = strata::test::Make3mf(model);
    return strata::io::OpenMesh(strata::io::MemorySource(package, "a.3mf"), options);
  });
}
