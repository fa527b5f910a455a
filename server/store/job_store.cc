#include "server/store/job_store.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>

#include "server/store/job_rows.h"
#include "server/store/page_token.h"

namespace strata::server {
namespace {

constexpr char kTokenKind = 'j';
constexpr std::size_t kMaxOptionsBytes = 64 << 10;
constexpr std::size_t kMaxKeyBytes = 255;

Result<void> CheckRequest(const JobRequest& request) {
  if (!IsHash(request.model_hash)) {
    return Fail(ErrorCode::kInvalidArgument, "job: the model's SHA-256 is not 64 hex digits");
  }
  if (request.options.size() > kMaxOptionsBytes) {
    return Fail(ErrorCode::kInvalidArgument,
                "job: options of " + std::to_string(request.options.size()) +
                    " bytes, expected at most " + std::to_string(kMaxOptionsBytes));
  }
  if (request.idempotency_key.size() > kMaxKeyBytes) {
    return Fail(ErrorCode::kInvalidArgument,
                "job: an idempotency key of " + std::to_string(request.idempotency_key.size()) +
                    " bytes, expected at most " + std::to_string(kMaxKeyBytes));
  }
  return {};
}

std::int64_t MaskOf(const std::vector<JobState>& states) {
  std::int64_t mask = states.empty() ? -1 : 0;
  for (const JobState state : states) mask |= std::int64_t{1} << static_cast<int>(state);
  return mask;
}

std::optional<std::int64_t> Millis(const std::optional<Timestamp>& time) {
  return time ? std::optional(ToMillis(*time)) : std::nullopt;
}

}  // namespace

Result<std::unique_ptr<JobStore>> JobStore::Open(const Parts& parts, const JobLimits& limits) {
  std::unique_ptr<JobStore> store(new JobStore(parts, limits));
  if (store->shared_) return store;
  if (auto counted = store->CountStates(); !counted) return Forward(counted);
  if (auto queued = store->RequeueLost("its process ended"); !queued) return Forward(queued);
  return store;
}

Result<void> JobStore::CountStates() {
  for (const auto& [state, count] :
       {std::pair{JobState::kQueued, &queued_}, {JobState::kRunning, &running_}}) {
    const auto counted = CountState(state);
    if (!counted) return Forward(counted);
    *count = *counted;
  }
  return {};
}

Result<std::uint64_t> JobStore::CountState(JobState state) const {
  std::int64_t count = 0;
  auto counted = parts_.database.Read().Query(
      "SELECT count(*) FROM jobs WHERE state = ?", [&](const Row& row) { count = row.Int(0); },
      static_cast<std::int64_t>(state));
  if (!counted) return Forward(counted);
  return static_cast<std::uint64_t>(count);
}

void JobStore::Count(JobState from, JobState to) {
  const std::lock_guard lock(mutex_);
  if (!shared_) {
    if (from == JobState::kQueued) --queued_;
    if (from == JobState::kRunning) --running_;
    if (to == JobState::kQueued) ++queued_;
    if (to == JobState::kRunning) ++running_;
  }
  if (to != JobState::kQueued || from == JobState::kQueued) return;
  ++arrivals_;
  queued_came_.notify_all();
}

std::uint64_t JobStore::queued() const {
  if (shared_) return CountState(JobState::kQueued).value_or(0);
  const std::lock_guard lock(mutex_);
  return queued_;
}

std::uint64_t JobStore::running() const {
  if (shared_) return CountState(JobState::kRunning).value_or(0);
  const std::lock_guard lock(mutex_);
  return running_;
}

Result<CreatedJob> JobStore::Create(const JobRequest& request) {
  if (auto checked = CheckRequest(request); !checked) return Forward(checked);
  const auto lock = LockChanges();
  auto made = CreateLocked(request);
  if (made && made->created) HearOfQueue();
  return made;
}

void JobStore::HearOfQueue() {
  {
    const std::lock_guard lock(mutex_);
    ++arrivals_;
  }
  queued_came_.notify_all();
}

Result<CreatedJob> JobStore::CreateLocked(const JobRequest& request) {
  auto session = parts_.database.Write();
  if (!session) return Forward(session);
  if (!request.idempotency_key.empty()) {
    const auto earlier = FindJobByKey(*session, request.client, request.idempotency_key);
    if (!earlier) return Forward(earlier);
    if (*earlier && RequestHash((*earlier)->request) == RequestHash(request)) {
      return CreatedJob{**earlier, false};
    }
    if (*earlier) {
      return Fail(ErrorCode::kConflict,
                  "job: the idempotency key was used for another request, job " + (*earlier)->id);
    }
  }
  std::uint64_t waiting = 0;
  auto counted = session->Query("SELECT count(*) FROM jobs WHERE state = 0", [&](const Row& row) {
    waiting = static_cast<std::uint64_t>(row.Int(0));
  });
  if (!counted) return Forward(counted);
  if (waiting >= limits_.max_queued) {
    return Fail(ErrorCode::kOverBudget,
                std::to_string(waiting) + " jobs are queued, which is the limit");
  }
  Job job;
  job.id = RandomId();
  job.request = request;
  const auto now = session->Now();
  if (!now) return Forward(now);
  job.created = *now;
  if (auto inserted = InsertJob(*session, job); !inserted) return Forward(inserted);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  if (!shared_) {
    const std::lock_guard lock(mutex_);
    ++queued_;
  }
  return CreatedJob{job, true};
}

Result<Job> JobStore::Get(const std::string& id) {
  Session session = parts_.database.Read();
  auto job = FindJob(session, id);
  if (!job) return Forward(job);
  if (!*job) return FailNoSuchJob();
  return **job;
}

Result<JobPage> JobStore::List(const JobQuery& query) {
  if (auto size = CheckPageSize(query.size); !size) return Forward(size);
  const auto last = ReadPageToken(kTokenKind, query.page_token);
  if (!last) return Forward(last);
  std::optional<std::int64_t> before;
  if (!last->empty()) before = std::strtoll(last->c_str(), nullptr, 10);
  static const std::string kSelect =
      "SELECT " + kJobColumns +
      " FROM jobs WHERE (?1 IS NULL OR number < ?1) AND ((?2 >> CAST(state AS INTEGER)) & 1) = 1"
      " AND (?3 IS NULL OR model = ?3) AND (?4 IS NULL OR client = ?4)"
      " AND (?5 IS NULL OR created >= ?5) AND (?6 IS NULL OR created < ?6)"
      " ORDER BY number DESC LIMIT ?7";
  JobPage page;
  auto asked = parts_.database.Read().Query(
      kSelect, [&](const Row& row) { page.jobs.push_back(ReadJob(row)); }, before,
      MaskOf(query.states), query.model, query.client, Millis(query.created_from),
      Millis(query.created_before), static_cast<std::int64_t>(query.size + 1));
  if (!asked) return Forward(asked);
  if (page.jobs.size() > query.size) {
    page.jobs.resize(query.size);
    page.next = MakePageToken(kTokenKind, std::to_string(page.jobs.back().number));
  }
  return page;
}

Result<std::size_t> JobStore::Purge(Timestamp time, std::size_t count) {
  std::vector<std::pair<std::int64_t, std::string>> jobs;
  {
    auto session = parts_.database.Write();
    if (!session) return Forward(session);
    auto listed = session->Query(
        "SELECT number, result_blob FROM jobs WHERE finished < ? ORDER BY finished LIMIT ?",
        [&](const Row& row) { jobs.emplace_back(row.Int(0), row.Text(1)); }, ToMillis(time),
        static_cast<std::int64_t>(count));
    if (!listed) return Forward(listed);
    for (const auto& [number, blob] : jobs) {
      auto deleted = session->Run("DELETE FROM jobs WHERE number = ?", number);
      if (!deleted) return Forward(deleted);
    }
    if (auto committed = session->Commit(); !committed) return Forward(committed);
  }
  for (const auto& [number, blob] : jobs) {
    if (!blob.empty()) parts_.blobs.Collect(blob);
  }
  return jobs.size();
}

Result<std::shared_ptr<JobSubscription>> JobStore::Subscribe(const std::string& id,
                                                             std::uint64_t after,
                                                             std::function<void()> on_event) {
  const auto lock = LockChanges();
  // Before the job is read: what changes between the two is told.
  auto follower = events_.Subscribe(id, std::move(on_event), after);
  const auto job = Get(id);
  if (!job) return Forward(job);
  // Who has seen the end is told again: its events would otherwise never end.
  events_.Tell(*follower, std::make_shared<const Job>(*job));
  if (IsFinished(job->state)) events_.Publish(std::make_shared<const Job>(*job));
  return follower;
}

void JobStore::HearOfJob(const std::string& text) {
  const std::size_t space = text.find(' ');
  if (space == std::string::npos) return;
  const std::string id = text.substr(0, space);
  if (!events_.Wants(id, std::strtoull(text.c_str() + space, nullptr, 10))) return;
  // If it cannot be read now, Look tries again.
  if (const auto job = Get(id)) events_.Publish(std::make_shared<const Job>(*job));
}

void JobStore::Look() {
  HearOfQueue();
  for (const std::string& id : events_.Followed()) {
    const auto job = Get(id);
    if (job && events_.Wants(id, job->sequence)) events_.Publish(std::make_shared<const Job>(*job));
    if (!job && IsDatabaseAway(job.error())) return;
  }
}

Result<Job> JobStore::WaitForEnd(const std::string& id, Milliseconds timeout) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  const auto follower = Subscribe(id);
  if (!follower) return Forward(follower);
  JobEvent last;
  for (Milliseconds left = timeout;;) {
    const JobEvent event = (*follower)->Next(left);
    if (event == nullptr) return *last;
    last = event;
    left =
        std::max(Milliseconds(0),
                 std::chrono::duration_cast<Milliseconds>(end - std::chrono::steady_clock::now()));
  }
}

}  // namespace strata::server
