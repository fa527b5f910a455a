#include "server/store/job_store.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <thread>

#include "tests/server/store/store_fixture.h"

namespace strata::server {
namespace {

constexpr Milliseconds kNoWait{0};
constexpr Milliseconds kLong = std::chrono::seconds(20);  // A bound: what is waited for comes.

class JobStoreTest : public StoreTest {
 protected:
  JobStore& jobs() { return store->jobs(); }
  static JobRequest Request(const std::string& job_options = "{}", const std::string& key = "") {
    return {"model", HashOf("model"), job_options, HashOf("key"), "client", key};
  }
  std::string Create(const std::string& job_options = "{}") {
    const auto made = jobs().Create(Request(job_options));
    EXPECT_OK(made);
    return made ? made->job.id : std::string();
  }
  JobStore::Claimed Claim(const std::string& owner = "worker") {
    auto claimed = jobs().Claim(owner);
    EXPECT_OK(claimed);
    if (!claimed || !*claimed) {
      ADD_FAILURE() << "nothing to claim";
      return {};
    }
    return **claimed;
  }
  bool NothingToClaim() {
    const auto claimed = jobs().Claim("worker");
    EXPECT_OK(claimed);
    return claimed && !*claimed;
  }
  JobState StateOf(const std::string& id) {
    const auto job = jobs().Get(id);
    EXPECT_OK(job);
    return job ? job->state : JobState::kQueued;
  }
};

TEST_F(JobStoreTest, GoesFromQueuedOverRunningToSucceeded) {
  const std::string id = Create("{\"resolution\":7}");
  EXPECT_EQ(id.size(), 32u);
  EXPECT_EQ(StateOf(id), JobState::kQueued);
  clock.Advance(std::chrono::seconds(1));
  const auto claimed = Claim();
  EXPECT_EQ(claimed.job.id, id);
  EXPECT_EQ(claimed.job.request.options, "{\"resolution\":7}");
  EXPECT_EQ(claimed.job.attempts, 1);
  EXPECT_EQ(*jobs().Heartbeat(claimed.claim, {"scan", 10, 100}), true);
  EXPECT_EQ(jobs().Get(id)->progress, (JobProgress{"scan", 10, 100}));
  const auto blob = NewBlob("samples", BlobKind::kResult);
  ASSERT_OK(blob);
  ASSERT_OK(jobs().Succeed(claimed.claim, *blob, {"", 0, "text/plain", "{\"n\":1}"}));
  const auto job = jobs().Get(id);
  ASSERT_OK(job);
  EXPECT_EQ(job->state, JobState::kSucceeded);
  EXPECT_EQ(job->result->hash, HashOf("samples"));
  EXPECT_EQ(job->result->size, 7u);
  EXPECT_EQ(job->result->media_type, "text/plain");
  EXPECT_EQ(job->result->summary, "{\"n\":1}");
  EXPECT_EQ(*job->started, clock.Now());
  EXPECT_EQ(*job->finished, clock.Now());
  EXPECT_EQ(job->owner, "");
}

TEST_F(JobStoreTest, AFailureKeepsItsCodeAndMessage) {
  const std::string id = Create();
  ASSERT_OK(jobs().MarkFailed(Claim().claim, {ErrorCode::kCorruptInput, "a.ply: byte 7"}));
  const auto job = jobs().Get(id);
  EXPECT_EQ(job->state, JobState::kFailed);
  EXPECT_EQ(job->error->code, ErrorCode::kCorruptInput);
  EXPECT_EQ(job->error->message, "a.ply: byte 7");
}

TEST_F(JobStoreTest, TheSameKeyAndRequestIsTheSameJobAlsoAfterARestart) {
  const auto first = jobs().Create(Request("a", "key"));
  ASSERT_OK(first);
  EXPECT_TRUE(first->created);
  const auto second = jobs().Create(Request("a", "key"));
  ASSERT_OK(second);
  EXPECT_FALSE(second->created);
  EXPECT_EQ(second->job.id, first->job.id);
  Open();
  EXPECT_EQ(jobs().Create(Request("a", "key"))->job.id, first->job.id);
  EXPECT_FAILS(ErrorCode::kConflict, jobs().Create(Request("b", "key")));
  JobRequest other_client = Request("b", "key");
  other_client.client = "somebody else";
  EXPECT_TRUE(jobs().Create(other_client)->created) << "keys belong to clients";
  EXPECT_TRUE(jobs().Create(Request("a"))->created) << "no key, no memory";
}

TEST_F(JobStoreTest, OneKeyUsedByManyAtOnceMakesOneJob) {
  std::vector<std::thread> threads;
  std::mutex mutex;
  std::set<std::string> ids;
  std::atomic<int> created = 0;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] {
      const auto made = jobs().Create(Request("a", "key"));
      if (made && made->created) ++created;
      const std::lock_guard lock(mutex);
      ids.insert(made ? made->job.id : "failed");
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(created, 1);
  EXPECT_EQ(ids.size(), 1u);
}

TEST_F(JobStoreTest, AFullQueueRefusesAndTakesAgainWhenThereIsRoom) {
  options.jobs.max_queued = 2;
  Open();
  Create();
  Create();
  EXPECT_FAILS(ErrorCode::kOverBudget, jobs().Create(Request()));
  Claim();
  EXPECT_OK(jobs().Create(Request()));
  Open();
  EXPECT_EQ(jobs().queued(), 3u) << "what ran is queued again, over the limit too";
  EXPECT_FAILS(ErrorCode::kOverBudget, jobs().Create(Request()));
}

TEST_F(JobStoreTest, RefusesRequestsBeyondTheirLimits) {
  JobRequest request = Request();
  request.model_hash = "../../etc";
  EXPECT_FAILS(ErrorCode::kInvalidArgument, jobs().Create(request));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, jobs().Create(Request(std::string(70'000, 'x'))));
  EXPECT_FAILS(ErrorCode::kInvalidArgument, jobs().Create(Request("a", std::string(256, 'k'))));
}

TEST_F(JobStoreTest, ManyWorkersClaimEachJobOnceInTheOrderOfTheirMaking) {
  std::vector<std::string> made;
  for (int i = 0; i < 24; ++i) made.push_back(Create());
  std::mutex mutex;
  std::map<std::string, int> claims;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      std::int64_t last = 0;
      for (;;) {
        const auto claimed = jobs().Claim("worker " + std::to_string(t));
        if (!claimed || !*claimed) return;
        EXPECT_GT((*claimed)->job.number, last);
        last = (*claimed)->job.number;
        const std::lock_guard lock(mutex);
        ++claims[(*claimed)->job.id];
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(claims.size(), made.size());
  for (const auto& [id, count] : claims) EXPECT_EQ(count, 1) << id;
  EXPECT_EQ(jobs().running(), 24u);
}

TEST_F(JobStoreTest, AfterARestartRunningJobsAreQueuedAgainAndOldClaimsAreVoid) {
  const std::string first = Create(), second = Create();
  const auto claimed = Claim();
  ASSERT_OK(jobs().Heartbeat(claimed.claim, {"scan", 1, 2}));
  Open();
  EXPECT_EQ(StateOf(first), JobState::kQueued);
  EXPECT_FAILS(ErrorCode::kConflict, jobs().Heartbeat(claimed.claim, {}));
  const auto again = Claim();
  EXPECT_EQ(again.job.id, first) << "at its old place";
  EXPECT_EQ(again.job.attempts, 2);
  EXPECT_EQ(again.job.progress, JobProgress{});
  const auto blob = NewBlob("late", BlobKind::kResult);
  EXPECT_FAILS(ErrorCode::kConflict, jobs().Succeed(claimed.claim, *blob, {}));
  EXPECT_FAILS(ErrorCode::kConflict, jobs().MarkFailed(claimed.claim, {}));
  EXPECT_EQ(StateOf(first), JobState::kRunning);
  EXPECT_EQ(StateOf(second), JobState::kQueued);
}

TEST_F(JobStoreTest, AJobThatNeverEndsHasFailedAtLast) {
  options.jobs.max_attempts = 3;
  Open();
  const std::string id = Create();
  for (int i = 0; i < 3; ++i) {
    Claim();
    Open();
  }
  EXPECT_EQ(StateOf(id), JobState::kFailed);
  EXPECT_NE(jobs().Get(id)->error->message.find("3 times"), std::string::npos);
  EXPECT_TRUE(NothingToClaim());
}

TEST_F(JobStoreTest, AJobThatIsTriedAgainFailsWithTheReasonOfItsLastTry) {
  options.jobs.max_attempts = 2;
  Open();
  const std::string id = Create();
  ASSERT_OK(jobs().Release(Claim().claim));  // It costs nothing.
  ASSERT_OK(jobs().TryAgain(Claim().claim, {ErrorCode::kIo, "first"}));
  EXPECT_EQ(StateOf(id), JobState::kQueued);
  ASSERT_OK(jobs().Release(Claim().claim));
  ASSERT_OK(jobs().TryAgain(Claim().claim, {ErrorCode::kIo, "second"}));
  EXPECT_EQ(StateOf(id), JobState::kFailed);
  EXPECT_TRUE(NothingToClaim());
  const Job job = *jobs().Get(id);
  EXPECT_EQ(job.error->code, ErrorCode::kIo);
  EXPECT_TRUE(job.error->message.starts_with("second; ")) << job.error->message;
  ASSERT_EQ(job.history.size(), 4u);
  EXPECT_EQ(job.history[1].why, "failed: first");
  EXPECT_EQ(job.history[3].why, "failed: second");
}

TEST_F(JobStoreTest, ALeaseRunsOutWithoutAHeartbeatAndNotBefore) {
  const std::string id = Create();
  const auto claimed = Claim();
  clock.Advance(options.jobs.lease - Milliseconds(1));
  EXPECT_EQ(*jobs().ExpireLeases(), 0u);
  ASSERT_OK(jobs().Heartbeat(claimed.claim, {}));
  clock.Advance(options.jobs.lease - Milliseconds(1));
  EXPECT_EQ(*jobs().ExpireLeases(), 0u);
  clock.Advance(Milliseconds(1));
  EXPECT_EQ(*jobs().ExpireLeases(), 1u);
  EXPECT_EQ(StateOf(id), JobState::kQueued);
  EXPECT_FAILS(ErrorCode::kConflict, jobs().Heartbeat(claimed.claim, {}));
}

TEST_F(JobStoreTest, AQueuedJobIsCancelledAtOnce) {
  const std::string id = Create();
  EXPECT_EQ(jobs().Cancel(id)->state, JobState::kCancelled);
  EXPECT_EQ(jobs().Cancel(id)->state, JobState::kCancelled) << "twice is once";
  EXPECT_TRUE(NothingToClaim());
  EXPECT_EQ(jobs().queued(), 0u);
  EXPECT_FAILS(ErrorCode::kNotFound, jobs().Cancel("none"));
}

TEST_F(JobStoreTest, ARunningJobsOwnerHearsOfTheCancelling) {
  const std::string id = Create();
  const auto claimed = Claim();
  EXPECT_EQ(jobs().Cancel(id)->state, JobState::kRunning);
  EXPECT_EQ(*jobs().Heartbeat(claimed.claim, {}), false);
  ASSERT_OK(jobs().MarkCancelled(claimed.claim));
  EXPECT_EQ(StateOf(id), JobState::kCancelled);
  EXPECT_EQ(jobs().Cancel(id)->state, JobState::kCancelled);
}

TEST_F(JobStoreTest, ACancelledJobDoesNotRunAgainAfterARestart) {
  const std::string id = Create();
  Claim();
  ASSERT_OK(jobs().Cancel(id));
  Open();
  EXPECT_EQ(StateOf(id), JobState::kCancelled);
}

TEST_F(JobStoreTest, AReleasedJobIsNextInLineAgain) {
  const std::string first = Create();
  Create();
  ASSERT_OK(jobs().Release(Claim().claim));
  EXPECT_EQ(Claim().job.id, first);
}

TEST_F(JobStoreTest, ListsTheLatestFirstByFilterAndPage) {
  std::vector<std::string> ids;
  for (int i = 0; i < 9; ++i) {
    JobRequest request = Request();
    request.model = i % 3 == 0 ? "third" : "other";
    ids.push_back(jobs().Create(request)->job.id);
    clock.Advance(std::chrono::seconds(1));
  }
  const auto list = [&](JobQuery query) {
    std::vector<std::string> found;
    for (int pages = 0; pages < 100; ++pages) {
      const auto page = jobs().List(query);
      EXPECT_OK(page);
      for (const Job& job : page->jobs) found.push_back(job.id);
      if (page->next.empty()) break;
      query.page_token = page->next;
    }
    return found;
  };
  for (const std::size_t size : {1, 4, 9, 10}) {
    JobQuery query;
    query.size = size;
    EXPECT_EQ(list(query), std::vector(ids.rbegin(), ids.rend())) << "pages of " << size;
  }
  JobQuery query;
  query.model = "third";
  EXPECT_EQ(list(query), (std::vector{ids[6], ids[3], ids[0]}));
  Claim();
  query.states = {JobState::kRunning};
  EXPECT_EQ(list(query), std::vector{ids[0]});
  query = {};
  query.created_from = clock.Now() - std::chrono::seconds(3);
  query.created_before = clock.Now() - std::chrono::seconds(1);
  EXPECT_EQ(list(query), (std::vector{ids[7], ids[6]}));
  query = {};
  query.client = "nobody";
  EXPECT_TRUE(list(query).empty());
  query = {};
  query.page_token = "m3132";
  EXPECT_FAILS(ErrorCode::kInvalidArgument, jobs().List(query));
}

TEST_F(JobStoreTest, NewJobsDoNotMoveOldOnesOutOfPages) {
  std::vector<std::string> ids;
  for (int i = 0; i < 4; ++i) ids.push_back(Create());
  JobQuery query;
  query.size = 2;
  query.page_token = jobs().List(query)->next;
  Create();
  const auto page = jobs().List(query);
  ASSERT_EQ(page->jobs.size(), 2u);
  EXPECT_EQ(page->jobs[0].id, ids[1]);
  EXPECT_EQ(page->jobs[1].id, ids[0]);
}

TEST_F(JobStoreTest, PurgingForgetsOldFinishedJobsAndTheirResults) {
  Create();
  auto blob = NewBlob("result", BlobKind::kResult);
  ASSERT_OK(jobs().Succeed(Claim().claim, *blob, {}));
  const std::string queued = Create();
  clock.Advance(std::chrono::hours(2));
  EXPECT_EQ(*jobs().Purge(clock.Now() - std::chrono::hours(3)), 0u);
  EXPECT_EQ(*jobs().Purge(clock.Now() - std::chrono::hours(1)), 1u);
  EXPECT_EQ(StateOf(queued), JobState::kQueued);
  EXPECT_EQ(Files("blobs").size(), 1u) << "pinned here";
  *blob = BlobPin();
  EXPECT_TRUE(Files("blobs").empty());
}

TEST_F(JobStoreTest, AFollowerSeesEveryStateInOrderAndThenTheEnd) {
  const std::string id = Create();
  auto follower = jobs().Subscribe(id);
  ASSERT_OK(follower);
  const auto claimed = Claim();
  ASSERT_OK(jobs().Heartbeat(claimed.claim, {"scan", 1, 2}));
  ASSERT_OK(jobs().MarkFailed(claimed.claim, {ErrorCode::kIo, "x"}));
  std::vector<JobState> states;
  std::uint64_t last = 0;
  while (const auto event = (*follower)->Next(kNoWait)) {
    EXPECT_GT(event->sequence, last);
    last = event->sequence;
    states.push_back(event->state);
  }
  EXPECT_EQ(states, (std::vector{JobState::kQueued, JobState::kRunning, JobState::kRunning,
                                 JobState::kFailed}));
  EXPECT_TRUE((*follower)->ended());
  EXPECT_FALSE((*follower)->Next(kLong)) << "returns at once";
}

TEST_F(JobStoreTest, AFollowerWhoComesBackGetsWhatIsNew) {
  const std::string id = Create();
  const auto claimed = Claim();
  const std::uint64_t seen = claimed.job.sequence;
  auto follower = jobs().Subscribe(id, seen);
  ASSERT_OK(follower);
  EXPECT_FALSE((*follower)->Next(kNoWait)) << "it has seen that";
  ASSERT_OK(jobs().Heartbeat(claimed.claim, {"scan", 1, 2}));
  EXPECT_EQ((*jobs().Subscribe(id, seen))->Next(kNoWait)->progress.done, 1u);
  EXPECT_EQ((*follower)->Next(kNoWait)->sequence, seen + 1);
  ASSERT_OK(jobs().MarkCancelled(claimed.claim));
  Open();
  follower = jobs().Subscribe(id, 1'000);
  EXPECT_EQ((*follower)->Next(kNoWait)->state, JobState::kCancelled) << "so that it ends";
  EXPECT_FAILS(ErrorCode::kNotFound, jobs().Subscribe("none"));
}

TEST_F(JobStoreTest, ASlowFollowerMissesProgressAndNeverAState) {
  const std::string id = Create();
  std::atomic<int> calls = 0;
  auto follower = jobs().Subscribe(id, 0, [&] { ++calls; });
  const auto claimed = Claim();
  for (std::uint64_t i = 1; i <= 200; ++i) {
    ASSERT_OK(jobs().Heartbeat(claimed.claim, {"scan", i, 200}));
  }
  ASSERT_OK(jobs().MarkCancelled(claimed.claim));
  EXPECT_EQ(calls, 203);
  std::vector<Job> events;
  while (const auto event = (*follower)->Next(kNoWait)) events.push_back(*event);
  EXPECT_LE(events.size(), JobSubscription::kMaxWaiting + 1);
  EXPECT_EQ(events.front().state, JobState::kQueued);
  EXPECT_EQ(events.back().state, JobState::kCancelled);
  EXPECT_EQ(events[events.size() - 2].progress.done, 200u) << "the latest progress is kept";
}

TEST_F(JobStoreTest, WaitersWakeWhenAJobOrAnEventComes) {
  EXPECT_FALSE(jobs().WaitForQueued(kNoWait));
  std::thread worker([&] {
    EXPECT_TRUE(jobs().WaitForQueued(kLong));
    const auto claimed = Claim();
    EXPECT_OK(jobs().MarkCancelled(claimed.claim));
  });
  const std::string id = Create();
  auto follower = jobs().Subscribe(id);
  while (const auto event = (*follower)->Next(kLong)) {
  }
  EXPECT_TRUE((*follower)->ended());
  worker.join();
}

TEST_F(JobStoreTest, WaitingForTheEndReturnsItOrTheStateAtTheTimeout) {
  const std::string id = Create();
  EXPECT_EQ(jobs().WaitForEnd(id, kNoWait)->state, JobState::kQueued);
  const auto claimed = Claim();
  std::thread worker([&] { EXPECT_OK(jobs().MarkCancelled(claimed.claim)); });
  EXPECT_EQ(jobs().WaitForEnd(id, kLong)->state, JobState::kCancelled);
  worker.join();
  EXPECT_EQ(jobs().WaitForEnd(id, kLong)->state, JobState::kCancelled);
  EXPECT_FAILS(ErrorCode::kNotFound, jobs().WaitForEnd("none", kNoWait));
}

}  // namespace
}  // namespace strata::server
