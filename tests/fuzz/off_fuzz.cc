// Arbitrary bytes as an OFF file, whole and in dribs.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "io/off_reader.h"
#include "tests/fuzz/drain.h"
#include "tests/support/failing_source.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  strata::io::OpenOptions options;
  options.max_line_bytes = 300;
  auto whole = strata::io::OpenOff(strata::io::MemorySource(bytes), options);
  auto dribs = strata::io::OpenOff(
      strata::test::Dribble(strata::io::MemorySource(bytes), 1 + size % 13), options);
  if (whole.has_value() != dribs.has_value()) {
    // Packed data that are damaged: what is read at once with the header fails with it.
    strata::test::Require(strata::test::Drain(whole ? **whole : **dribs, 5).failed);
  }
  if (whole && dribs) {
    const auto first = strata::test::Drain(**whole, 64);
    const auto second = strata::test::Drain(**dribs, 5);
    strata::test::Require(first.failed == second.failed);
    // An error takes the triangles of its batch with it.
    strata::test::Require(first.failed || first.triangles == second.triangles);
    strata::test::Require(first.failed || first.sum == second.sum || first.sum - first.sum != 0);
  }
  strata::test::DrainTwice(strata::io::OpenOff(strata::io::MemorySource(bytes), options));
  return 0;
}
