#include "server/store/job_store.h"

#include <algorithm>
#include <chrono>

#include "server/store/job_rows.h"
#include "server/store/page_token.h"

namespace strata::server {
namespace {

constexpr char kTokenKind = 'j';
constexpr std::size_t kMaxOptionsBytes = 64 << 10;
constexpr std::size_t kMaxKeyBytes = 255;

tl::unexpected<Error> FailMissing() {
  return Fail(ErrorCode::kNotFound, "job: there is none of this name");
}

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
  if (auto counted = store->CountStates(); !counted) return Forward(counted);
  const auto running = static_cast<std::int64_t>(JobState::kRunning);
  if (auto queued = store->RequeueWhere("state = ?", running); !queued) return Forward(queued);
  return store;
}

Result<void> JobStore::CountStates() {
  auto counted = parts_.database.Read().Query(
      "SELECT state, count(*) FROM jobs WHERE state <= 1 GROUP BY state", [&](const Row& row) {
        const bool queued = static_cast<JobState>(row.Int(0)) == JobState::kQueued;
        (queued ? queued_ : running_) = static_cast<std::uint64_t>(row.Int(1));
      });
  if (!counted) return Forward(counted);
  return {};
}

void JobStore::Count(JobState from, JobState to) {
  if (from == JobState::kQueued) --queued_;
  if (from == JobState::kRunning) --running_;
  if (to == JobState::kQueued) ++queued_;
  if (to == JobState::kRunning) ++running_;
  if (to == JobState::kQueued) queued_came_.notify_one();
}

std::uint64_t JobStore::queued() const {
  const std::lock_guard lock(mutex_);
  return queued_;
}

std::uint64_t JobStore::running() const {
  const std::lock_guard lock(mutex_);
  return running_;
}

Result<CreatedJob> JobStore::Create(const JobRequest& request) {
  if (auto checked = CheckRequest(request); !checked) return Forward(checked);
  const std::lock_guard lock(mutex_);
  auto made = CreateLocked(request);
  if (made && made->created) {
    ++queued_;
    queued_came_.notify_one();
  }
  return made;
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
  if (queued_ >= limits_.max_queued) {
    return Fail(ErrorCode::kOverBudget,
                std::to_string(queued_) + " jobs are queued, which is the limit");
  }
  Job job;
  job.id = RandomId();
  job.request = request;
  job.created = parts_.clock.Now();
  if (auto inserted = InsertJob(*session, job); !inserted) return Forward(inserted);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return CreatedJob{job, true};
}

Result<Job> JobStore::Get(const std::string& id) {
  Session session = parts_.database.Read();
  auto job = FindJob(session, id);
  if (!job) return Forward(job);
  if (!*job) return FailMissing();
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

Result<Job> JobStore::Apply(const std::string& id, const Change& change) {
  const std::lock_guard lock(mutex_);
  return ApplyLocked(id, change);
}

Result<Job> JobStore::ApplyLocked(const std::string& id, const Change& change) {
  Job job;
  JobState before = JobState::kQueued;
  {
    auto session = parts_.database.Write();
    if (!session) return Forward(session);
    auto found = FindJob(*session, id);
    if (!found) return Forward(found);
    if (!*found) return FailMissing();
    job = **found;
    before = job.state;
    if (auto changed = change(job); !changed) return Forward(changed);
    ++job.sequence;
    if (auto updated = UpdateJob(*session, job); !updated) return Forward(updated);
    if (auto committed = session->Commit(); !committed) return Forward(committed);
  }
  Count(before, job.state);
  events_.Publish(std::make_shared<const Job>(job));
  // Nothing keeps the model's content for this job any more.
  if (IsFinished(job.state)) parts_.blobs.Collect(job.request.model_hash);
  return job;
}

Result<std::optional<std::string>> JobStore::OldestQueued() {
  std::optional<std::string> id;
  auto asked =
      parts_.database.Read().Query("SELECT id FROM jobs WHERE state = 0 ORDER BY number LIMIT 1",
                                   [&](const Row& row) { id = row.Text(0); });
  if (!asked) return Forward(asked);
  return id;
}

Result<std::optional<JobStore::Claimed>> JobStore::Claim(const std::string& owner) {
  const std::lock_guard lock(mutex_);
  const auto id = OldestQueued();
  if (!id) return Forward(id);
  if (!*id) return std::nullopt;
  auto job = ApplyLocked(**id, [&](Job& claimed) -> Result<void> {
    claimed.state = JobState::kRunning;
    claimed.owner = owner;
    claimed.started = parts_.clock.Now();
    claimed.lease_until = *claimed.started + limits_.lease;
    claimed.progress = {};
    ++claimed.attempts;
    return {};
  });
  if (!job) return Forward(job);
  return Claimed{*job, {job->id, job->attempts}};
}

bool JobStore::WaitForQueued(Milliseconds timeout) {
  std::unique_lock lock(mutex_);
  return queued_came_.wait_for(lock, timeout, [this] { return queued_ > 0; });
}

Result<Job> JobStore::End(const JobClaim& claim, const Change& change) {
  return Apply(claim.id, [&](Job& job) -> Result<void> {
    if (job.state == JobState::kRunning && job.attempts == claim.attempt) return change(job);
    return Fail(ErrorCode::kConflict,
                "job " + job.id + ": attempt " + std::to_string(claim.attempt) +
                    " is over, the job belongs to somebody else or is finished");
  });
}

void JobStore::Finish(Job& job, JobState state) const {
  job.state = state;
  job.finished = parts_.clock.Now();
  job.owner.clear();
  job.lease_until.reset();
}

Result<bool> JobStore::Heartbeat(const JobClaim& claim, const JobProgress& progress) {
  auto job = End(claim, [&](Job& running) -> Result<void> {
    running.progress = progress;
    running.lease_until = parts_.clock.Now() + limits_.lease;
    return {};
  });
  if (!job) return Forward(job);
  return !job->cancel_requested;
}

Result<Job> JobStore::Succeed(const JobClaim& claim, const BlobPin& blob, JobResult result) {
  result.hash = blob.hash();
  result.size = blob.size();
  return End(claim, [&](Job& job) -> Result<void> {
    Finish(job, JobState::kSucceeded);
    job.result = result;
    return {};
  });
}

Result<Job> JobStore::MarkFailed(const JobClaim& claim, const Error& error) {
  return End(claim, [&](Job& job) -> Result<void> {
    Finish(job, JobState::kFailed);
    job.error = error;
    return {};
  });
}

Result<Job> JobStore::MarkCancelled(const JobClaim& claim) {
  return End(claim, [&](Job& job) -> Result<void> {
    Finish(job, JobState::kCancelled);
    return {};
  });
}

void JobStore::Requeue(Job& job) const {
  if (job.cancel_requested) return Finish(job, JobState::kCancelled);
  if (limits_.max_attempts > 0 && job.attempts >= limits_.max_attempts) {
    Finish(job, JobState::kFailed);
    job.error =
        Error{ErrorCode::kInternal, "the job was begun " + std::to_string(job.attempts) +
                                        " times and never came to an end, which is the limit"};
    return;
  }
  job.state = JobState::kQueued;
  job.owner.clear();
  job.lease_until.reset();
  job.progress = {};
}

Result<Job> JobStore::Release(const JobClaim& claim) {
  return End(claim, [&](Job& job) -> Result<void> {
    Requeue(job);
    return {};
  });
}

Result<Job> JobStore::Cancel(const std::string& id) {
  const std::lock_guard lock(mutex_);
  auto job = Get(id);
  if (!job || IsFinished(job->state) || job->cancel_requested) return job;
  return ApplyLocked(id, [&](Job& cancelled) -> Result<void> {
    cancelled.cancel_requested = true;
    if (cancelled.state == JobState::kQueued) Finish(cancelled, JobState::kCancelled);
    return {};
  });
}

Result<std::size_t> JobStore::RequeueWhere(const std::string& condition, std::int64_t value) {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> ids;
  auto listed = parts_.database.Read().Query(
      "SELECT id FROM jobs WHERE " + condition + " ORDER BY number",
      [&](const Row& row) { ids.push_back(row.Text(0)); }, value);
  if (!listed) return Forward(listed);
  for (const std::string& id : ids) {
    auto queued = ApplyLocked(id, [&](Job& job) -> Result<void> {
      Requeue(job);
      return {};
    });
    if (!queued) return Forward(queued);
  }
  return ids.size();
}

Result<std::size_t> JobStore::ExpireLeases() {
  return RequeueWhere("state = 1 AND lease_until <= ?", ToMillis(parts_.clock.Now()));
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
  const std::lock_guard lock(mutex_);
  const auto job = Get(id);
  if (!job) return Forward(job);
  // Who has seen the end is told again: its events would otherwise never end.
  const bool news = job->sequence > after || IsFinished(job->state);
  return events_.Subscribe(id, std::move(on_event),
                           news ? std::make_shared<const Job>(*job) : nullptr);
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
