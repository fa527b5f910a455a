#include "server/batch/schedule.h"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

#include "server/batch/batch_progress.h"

namespace strata::server {
namespace {

BatchTask Task(const ModelEntry& model, bool whole) {
  BatchTask task;
  task.model = &model;
  task.whole_machine = whole;
  return task;
}

TEST(Schedule, EveryTaskEndsOnceAndAWholeMachineIsNeverShared) {
  const ModelEntry model;
  std::vector<BatchTask> tasks;
  for (int i = 0; i < 120; ++i) tasks.push_back(Task(model, i % 10 == 0));
  Schedule schedule(tasks);
  std::atomic<int> running{0}, ended{0}, retried{0}, faults{0};
  std::vector<std::thread> lanes;
  for (int lane = 0; lane < 4; ++lane) {
    lanes.emplace_back([&] {
      while (auto task = schedule.Take()) {
        const int beside = running++;
        if (task->whole_machine && beside != 0) ++faults;
        std::this_thread::yield();
        if (task->whole_machine && running != 1) ++faults;
        --running;
        if (task->attempt == 1 && ended % 7 == 3) {
          ++retried;
          schedule.Retry(*task);
        } else {
          ++ended;
          schedule.End(*task);
        }
      }
    });
  }
  for (std::thread& lane : lanes) lane.join();
  EXPECT_EQ(ended, 120);
  EXPECT_GT(retried, 0);
  EXPECT_EQ(faults, 0) << "tasks beside one that has the whole machine";
}

TEST(Schedule, LargeOnesGoFirstAndRetriesLast) {
  const ModelEntry large, small, again;
  Schedule schedule({Task(small, false), Task(again, false), Task(large, true)});
  auto first = schedule.Take();
  ASSERT_TRUE(first);
  EXPECT_EQ(first->model, &large);
  schedule.End(*first);
  const auto second = schedule.Take(), third = schedule.Take();
  ASSERT_TRUE(second && third);
  EXPECT_EQ(second->model, &small);
  schedule.Retry(*third);
  schedule.End(*second);
  const auto last = schedule.Take();
  ASSERT_TRUE(last);
  EXPECT_EQ(last->model, &again);
  EXPECT_EQ(last->attempt, 2);
  EXPECT_TRUE(last->whole_machine);
  schedule.End(*last);
  EXPECT_FALSE(schedule.Take());
}

TEST(Schedule, StoppedHasNothingMoreAndWakesWhoWaits) {
  const ModelEntry model;
  Schedule schedule({Task(model, true), Task(model, true)});
  const auto running = schedule.Take();
  ASSERT_TRUE(running);
  std::thread waiting([&] { EXPECT_FALSE(schedule.Take()); });
  schedule.Stop();
  waiting.join();
}

TEST(BatchProgressLine, SaysHowFarHowFastAndHowLongStill) {
  BatchTally tally;
  tally.models = 1000;
  tally.skipped = 100;
  tally.sampled = 190;
  tally.failed = 10;
  EXPECT_EQ(BatchProgressLine(tally, 20, 25, 100),
            "300 of 1,000 models, 10 models/s, 1 min 00 s left, 10 failed");
  BatchTally begun;
  begun.models = 3;
  EXPECT_EQ(BatchProgressLine(begun, 0, 0, 1), "0 of 3 models, 0 failed");
}

}  // namespace
}  // namespace strata::server
