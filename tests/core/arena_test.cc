#include "core/arena.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <chrono>
#include <condition_variable>
#include <latch>
#include <mutex>
#include <thread>

namespace strata {
namespace {

/// How many threads came together, at most `wanted`; waits for that many, but not for ever.
class Meeting {
 public:
  explicit Meeting(int wanted) : wanted_(wanted) {}
  void Join() {
    std::unique_lock lock(mutex_);
    ++here_;
    came_.notify_all();
    came_.wait_for(lock, std::chrono::seconds(60), [this] { return here_ >= wanted_; });
  }
  int here() {
    const std::lock_guard lock(mutex_);
    return here_;
  }

 private:
  const int wanted_;
  std::mutex mutex_;
  std::condition_variable came_;
  int here_ = 0;
};

/// Of `threads` pieces of work how many had begun when the first one ended.
int WorkedTogether(int threads) {
  Meeting meeting(threads);
  int together = 0;
  std::once_flag first;
  InArena(threads, [&] {
    tbb::parallel_for(
        0, threads, 1,
        [&](int) {
          meeting.Join();
          std::call_once(first, [&] { together = meeting.here(); });
        },
        tbb::simple_partitioner());
    return true;
  });
  return together;
}

TEST(InArena, HasMoreThreadsThanProcessorsWhereMoreAreAskedFor) {
  const int threads = tbb::info::default_concurrency() + 3;
  EXPECT_EQ(WorkedTogether(threads), threads);
}

TEST(InArena, GivesAJobItsThreadsWhileAnotherHasOne) {
  std::latch begun(1), may_end(1);
  std::thread other([&] {
    InArena(1, [&] {
      begun.count_down();
      may_end.wait();
      return true;
    });
  });
  begun.wait();
  EXPECT_EQ(WorkedTogether(4), 4);
  may_end.count_down();
  other.join();
}

}  // namespace
}  // namespace strata
