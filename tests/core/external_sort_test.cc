#include "core/external_sort.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include "tests/support/memory_mesh.h"
#include "tests/support/scratch_test.h"

namespace strata::test {
namespace {

class ExternalSortTest : public ScratchTest {};

using Record = std::array<std::uint64_t, 3>;

std::vector<Record> Records(std::size_t n, std::uint64_t keys) {
  TestRandom random(11);
  std::vector<Record> records;
  for (std::size_t i = 0; i < n; ++i) records.push_back({random.Bits() % keys, i, ~random.Bits()});
  return records;
}

// Sorts the records and expects them as std::stable_sort leaves them.
void ExpectSorted(std::vector<Record> records, RunContext& context) {
  auto sorter =
      ExternalSort::Open(sizeof(Record), ExternalSort::kLeastBytes, "the records", context);
  ASSERT_TRUE(sorter);
  for (const Record& r : records) {
    ASSERT_TRUE((*sorter)->Add(reinterpret_cast<const char*>(r.data())));
  }
  ASSERT_TRUE((*sorter)->Sort());
  std::stable_sort(records.begin(), records.end(),
                   [](const Record& a, const Record& b) { return a[0] < b[0]; });
  for (const Record& expected : records) {
    const auto next = (*sorter)->Next();
    ASSERT_TRUE(next);
    ASSERT_NE(*next, nullptr);
    ASSERT_EQ(std::memcmp(*next, expected.data(), sizeof expected), 0);
  }
  for (int again = 0; again < 2; ++again) {
    const auto end = (*sorter)->Next();
    ASSERT_TRUE(end);
    EXPECT_EQ(*end, nullptr);
  }
}

TEST_F(ExternalSortTest, OrdersByKeyAndEqualKeysAsTheyCame) {
  RunContext context;
  context.SetScratch(scratch_.get());
  for (const std::size_t n : {0, 1, 2, 1000, 400'000}) {
    for (const std::uint64_t keys : {std::uint64_t{1}, std::uint64_t{50}, ~std::uint64_t{0}}) {
      SCOPED_TRACE(std::to_string(n) + " records, keys below " + std::to_string(keys));
      ExpectSorted(Records(n, keys), context);
    }
  }
  EXPECT_EQ(context.memory().taken(), 0u);
}

TEST_F(ExternalSortTest, SaysWhatItNeedsWhereThereIsNoScratchSpace) {
  RunContext context;
  auto sorter = ExternalSort::Open(24, ExternalSort::kLeastBytes, "the records", context);
  ASSERT_TRUE(sorter);
  Result<void> added;
  for (const Record& r : Records(100'000, 9)) {
    if (added) added = (*sorter)->Add(reinterpret_cast<const char*>(r.data()));
  }
  ASSERT_FALSE(added);
  EXPECT_EQ(added.error().code, ErrorCode::kOverBudget);
  EXPECT_EQ(added.error().message,
            "the records need more than 1048576 bytes of the memory budget, and no scratch space "
            "was given");
}

TEST_F(ExternalSortTest, StopsWhenCancelled) {
  RunContext context;
  context.SetScratch(scratch_.get());
  auto sorter = ExternalSort::Open(24, ExternalSort::kLeastBytes, "the records", context);
  ASSERT_TRUE(sorter);
  context.Cancel();
  Result<void> added;
  for (const Record& r : Records(100'000, 9)) {
    if (added) added = (*sorter)->Add(reinterpret_cast<const char*>(r.data()));
  }
  ASSERT_FALSE(added);
  EXPECT_EQ(added.error().code, ErrorCode::kCancelled);
}

}  // namespace
}  // namespace strata::test
