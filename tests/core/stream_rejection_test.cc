// The minimum distance on a stream equals the one on all samples at once.
#include "core/stream_rejection.h"

#include <gtest/gtest.h>

#include "core/rejection.h"
#include "tests/support/block_samples.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

TEST(StreamRejection, EqualsTheRejectionAtOnce) {
  for (const int tilt : {0, 1, 2, 7}) {
    for (const double m : {0.1, 0.5, 0.7, 1.0, 1.5, 4.0}) {
      TestRandom random(41);
      const Samples samples(Sheet(m < 0.8 ? 150 : 60, tilt, random));
      GatherOptions options;
      options.lattice = {{-0.3, 5, 1e3}, 0.7};
      options.surface = {{-1e9, -1e9, -1e9}, {1e9, 1e9, 1e9}};
      options.min_distance = m;
      const auto expected = AtOnce(samples, options);
      for (const std::uint64_t window :
           {std::uint64_t{1}, std::uint64_t{1} << 20, std::uint64_t{1} << 40}) {
        SCOPED_TRACE("seed 41, tilt " + std::to_string(tilt) + ", m " + std::to_string(m) +
                     ", window " + std::to_string(window));
        VectorStream stream(samples.blocks);
        RunContext context;
        const auto survivors =
            RejectStream(stream, {samples.places, samples.count}, options, window, context);
        if (!survivors) {  // What hangs together may not fit the smaller windows.
          EXPECT_EQ(survivors.error().code, ErrorCode::kOverBudget);
          EXPECT_LT(window, std::uint64_t{1} << 40) << survivors.error().message;
          EXPECT_GE(m, 0.7) << survivors.error().message;
          continue;
        }
        std::uint64_t differ = 0, count = 0;
        for (std::uint64_t i = 0; i < samples.count; ++i) {
          differ += survivors->Has(i) != (expected[i] == kSurvivingSample);
          count += expected[i] == kSurvivingSample;
        }
        EXPECT_EQ(differ, 0u);
        EXPECT_EQ(survivors->count, count);
      }
    }
  }
}

TEST(StreamRejection, SaysWhatATooSmallWindowNeeds) {
  TestRandom random(42);
  const Samples samples(Sheet(200, 1, random));
  GatherOptions options;
  options.surface = {{-1e9, -1e9, -1e9}, {1e9, 1e9, 1e9}};
  options.min_distance = 2;
  VectorStream stream(samples.blocks);
  RunContext context;
  const auto survivors = RejectStream(stream, {samples.places, samples.count}, options, 1, context);
  ASSERT_FALSE(survivors);
  EXPECT_EQ(survivors.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(survivors.error().message.find("need at least"), std::string::npos)
      << survivors.error().message;
}

}  // namespace
}  // namespace strata::test
