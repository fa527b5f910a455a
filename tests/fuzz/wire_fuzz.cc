// Arbitrary bytes as the options a gRPC client sends: refused with a message, or brought to a form
// that stays as it is.
#include <cstddef>
#include <cstdint>
#include <string>

#include "server/service/canonical_options.h"
#include "tests/fuzz/drain.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  strata::v1::SampleOptions options;
  if (!options.ParseFromArray(data, static_cast<int>(size))) return 0;
  const auto once = strata::server::Canonical(options);
  if (!once) {
    strata::test::Require(!once.error().message.empty());
    return 0;
  }
  const auto twice = strata::server::Canonical(*once);
  strata::test::Require(twice.has_value());
  strata::test::Require(once->SerializeAsString() == twice->SerializeAsString());
  strata::v1::SampleOptions read;
  strata::test::Require(strata::server::FromJson(strata::server::JsonOf(*once), read).has_value());
  strata::test::Require(read.SerializeAsString() == once->SerializeAsString());
  return 0;
}
