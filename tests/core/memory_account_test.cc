#include "core/memory_account.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <memory>
#include <thread>
#include <vector>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define STRATA_SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define STRATA_SANITIZED 1
#endif
#endif

namespace strata::test {
namespace {

TEST(MemoryAccount, GivesNoMoreThanItsBudgetAndTakesSharesBack) {
  MemoryAccount account(1000);
  auto first = account.Take(600, "the vertices");
  ASSERT_TRUE(first);
  EXPECT_EQ(account.left(), 400u);
  const auto refused = account.Take(401, "the reservoirs");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_EQ(refused.error().message,
            "the reservoirs need 401 bytes beside 600 in use, but the memory budget is 1000 bytes");
  EXPECT_TRUE(account.Take(400, "the reservoirs"));
  EXPECT_EQ(account.left(), 400u);
  *first = MemoryShare();
  EXPECT_EQ(account.left(), 1000u);
}

TEST(MemoryAccount, MovesSharesWithoutCountingThemTwice) {
  MemoryAccount account(10);
  {
    auto share = account.Take(7, "one");
    const MemoryShare moved = std::move(*share);
    EXPECT_EQ(moved.bytes(), 7u);
    EXPECT_EQ(account.taken(), 7u);
  }
  EXPECT_EQ(account.taken(), 0u);
}

TEST(MemoryAccount, NeverRefusesWithoutALimit) {
  MemoryAccount account;
  EXPECT_FALSE(account.limited());
  EXPECT_TRUE(account.Take(std::uint64_t{1} << 62, "much"));
}

TEST(MemoryAccount, IsExactUnderManyThreads) {
  MemoryAccount account(100);
  std::vector<std::thread> threads;
  std::atomic<int> over{0};
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 10000; ++i) {
        const auto share = account.Take(40, "a share");
        if (account.taken() > 100) ++over;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(over, 0);
  EXPECT_EQ(account.taken(), 0u);
}

std::uint64_t ResidentBytes() {
  std::uint64_t mapped = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> mapped >> resident;
  return resident * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

// As a grid that several threads filled: pieces too small to be mapped, between others that stay.
TEST(ReturnFreedMemory, LowersWhatTheProcessHolds) {
#if defined(STRATA_SANITIZED) || !defined(__GLIBC__)
  GTEST_SKIP() << "an allocator of another kind";
#endif
  constexpr std::size_t kPieces = 2048, kBytes = 28 << 10;
  std::vector<std::unique_ptr<char[]>> stay, go;
  std::thread([&] {
    for (std::size_t i = 0; i < kPieces; ++i) {
      go.emplace_back(new char[kBytes]);
      std::fill_n(go.back().get(), kBytes, 1);
      stay.emplace_back(new char[64]);
      stay.back()[0] = 1;
    }
  }).join();
  go.clear();
  const std::uint64_t before = ResidentBytes();
  ReturnFreedMemory();
  EXPECT_LT(ResidentBytes() + kPieces * kBytes / 2, before);
}

}  // namespace
}  // namespace strata::test
