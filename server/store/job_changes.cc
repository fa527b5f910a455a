// What changes a job: claims, heartbeats, ends, cancelling, leases that run out.
#include <algorithm>

#include "server/store/job_rows.h"
#include "server/store/job_store.h"

namespace strata::server {
namespace {

constexpr const char* kLeaseRanOut = "its lease ran out";
constexpr const char* kReleased = "released by its process";

tl::unexpected<Error> FailVoid(const JobClaim& claim) {
  return Fail(ErrorCode::kConflict,
              "job " + claim.id + ": attempt " + std::to_string(claim.attempt) +
                  " is over, the job belongs to somebody else or is finished");
}

}  // namespace

Result<Job> JobStore::Apply(const std::string& id, const Change& change) {
  const auto lock = LockChanges();
  return ApplyLocked(id, change);
}

Result<Job> JobStore::ApplyLocked(const std::string& id, const Change& change) {
  Job job;
  JobState before = JobState::kQueued;
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    const auto now = session->Now();
    if (!now) return Forward(now);
    auto found = FindJob(*session, id, parts_.database.for_update());
    if (!found) return Forward(found);
    if (!*found) return FailNoSuchJob();
    job = *std::move(*found);
    before = job.state;
    if (auto written = Write(*session, job, change, *now); !written) return Forward(written);
  }
  Tell(before, job);
  return job;
}

Result<void> JobStore::Write(Session& session, Job& job, const Change& change, Timestamp now) {
  if (auto changed = change(job, now); !changed) return changed;
  ++job.sequence;
  if (auto updated = UpdateJob(session, job); !updated) return updated;
  return session.Commit();
}

void JobStore::Tell(JobState before, const Job& job) {
  Count(before, job.state);
  events_.Publish(std::make_shared<const Job>(job));
  // Nothing keeps the model's content for this job any more.
  if (IsFinished(job.state)) parts_.blobs.Collect(job.request.model_hash);
}

Result<std::optional<JobStore::Claimed>> JobStore::Claim(const std::string& owner) {
  const auto lock = LockChanges();
  Job job;
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    const auto now = session->Now();
    if (!now) return Forward(now);
    auto found = FindQueued(*session, parts_.database.skip_locked());
    if (!found) return Forward(found);
    if (!*found) return std::nullopt;
    job = *std::move(*found);
    const auto claim = [&](Job& claimed, Timestamp at) -> Result<void> {
      claimed.state = JobState::kRunning;
      claimed.owner = owner;
      claimed.started = at;
      claimed.lease_until = at + limits_.lease;
      claimed.progress = {};
      claimed.history.push_back({++claimed.attempts, owner, at, std::nullopt, ""});
      return {};
    };
    if (auto written = Write(*session, job, claim, *now); !written) return Forward(written);
  }
  Tell(JobState::kQueued, job);
  return Claimed{job, {job.id, job.attempts}};
}

bool JobStore::WaitForQueued(Milliseconds timeout) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  while (true) {
    const std::uint64_t seen = arrivals();
    if (queued() > 0) return true;
    const auto left = std::chrono::ceil<Milliseconds>(end - std::chrono::steady_clock::now());
    if (left <= Milliseconds(0)) return false;
    WaitForArrival(seen, left);
  }
}

std::uint64_t JobStore::arrivals() const {
  const std::lock_guard lock(mutex_);
  return arrivals_;
}

void JobStore::WaitForArrival(std::uint64_t seen, Milliseconds timeout) {
  std::unique_lock lock(mutex_);
  queued_came_.wait_for(lock, timeout, [&] { return arrivals_ != seen; });
}

Result<Job> JobStore::End(const JobClaim& claim, const Change& change) {
  return Apply(claim.id, [&](Job& job, Timestamp now) -> Result<void> {
    const bool ours = job.state == JobState::kRunning && job.attempts == claim.attempt;
    // Over SQLite nobody else could have begun it.
    const bool in_time = !shared_ || (job.lease_until && now < *job.lease_until);
    return ours && in_time ? change(job, now) : Result<void>(FailVoid(claim));
  });
}

void JobStore::Finish(Job& job, JobState state, Timestamp now, const std::string& why) {
  job.state = state;
  job.finished = now;
  job.owner.clear();
  job.lease_until.reset();
  if (job.history.empty() || job.history.back().ended) return;
  job.history.back().ended = now;
  job.history.back().why = why;
}

Result<bool> JobStore::Heartbeat(const JobClaim& claim, const JobProgress& progress) {
  const auto lock = LockChanges();
  std::optional<Job> job;
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    const auto now = session->Now();
    if (!now) return Forward(now);
    // Over SQLite a lease that ran out while nobody looked goes on.
    const Timestamp valid = shared_ ? *now : Timestamp::min();
    auto beaten =
        BeatJob(*session, {claim.id, claim.attempt, progress, valid, *now + limits_.lease});
    if (!beaten) return Forward(beaten);
    job = *std::move(beaten);
    if (job) {
      if (auto committed = session->Commit(); !committed) return Forward(committed);
    } else {
      const auto there = FindJob(*session, claim.id);
      if (!there) return Forward(there);
      if (!*there) return FailNoSuchJob();
      return FailVoid(claim);
    }
  }
  Tell(JobState::kRunning, *job);
  return !job->cancel_requested;
}

Result<Job> JobStore::Succeed(const JobClaim& claim, const BlobPin& blob, JobResult result) {
  result.hash = blob.hash();
  result.size = blob.size();
  return End(claim, [&](Job& job, Timestamp now) -> Result<void> {
    Finish(job, JobState::kSucceeded, now, "succeeded");
    job.result = result;
    return {};
  });
}

Result<Job> JobStore::MarkFailed(const JobClaim& claim, const Error& error) {
  return End(claim, [&](Job& job, Timestamp now) -> Result<void> {
    Finish(job, JobState::kFailed, now, "failed: " + error.message);
    job.error = error;
    return {};
  });
}

Result<Job> JobStore::MarkCancelled(const JobClaim& claim) {
  return End(claim, [&](Job& job, Timestamp now) -> Result<void> {
    Finish(job, JobState::kCancelled, now, "cancelled");
    return {};
  });
}

void JobStore::Requeue(Job& job, Timestamp now, const std::string& why,
                       const std::optional<Error>& error) const {
  if (job.cancel_requested) return Finish(job, JobState::kCancelled, now, why);
  // A process that gave it back did nothing wrong to it.
  const auto lost = 1 + std::ranges::count_if(job.history, [](const JobAttempt& attempt) {
                      return attempt.ended && attempt.why != kReleased;
                    });
  if (limits_.max_attempts > 0 && why != kReleased && lost >= limits_.max_attempts) {
    Finish(job, JobState::kFailed, now, why);
    const std::string begun = "the job was begun " + std::to_string(job.attempts) + " times";
    job.error = error ? Error{error->code, error->message + "; " + begun + ", which is the limit"}
                      : Error{ErrorCode::kInternal,
                              begun + " and never came to an end, which is the limit"};
    return;
  }
  Finish(job, JobState::kQueued, now, why);
  job.finished.reset();
  job.progress = {};
}

Result<Job> JobStore::Release(const JobClaim& claim) {
  return End(claim, [&](Job& job, Timestamp now) -> Result<void> {
    Requeue(job, now, kReleased);
    return {};
  });
}

Result<Job> JobStore::TryAgain(const JobClaim& claim, const Error& error) {
  return End(claim, [&](Job& job, Timestamp now) -> Result<void> {
    Requeue(job, now, "failed: " + error.message, error);
    return {};
  });
}

Result<Job> JobStore::Cancel(const std::string& id) {
  const auto lock = LockChanges();
  bool changed = false;
  {
    const auto job = Get(id);
    if (!job || IsFinished(job->state) || job->cancel_requested) return job;
  }
  auto cancelled = ApplyLocked(id, [&](Job& job, Timestamp now) -> Result<void> {
    if (IsFinished(job.state)) return Fail(ErrorCode::kConflict, "job: is finished");
    changed = true;
    job.cancel_requested = true;
    if (job.state == JobState::kQueued) Finish(job, JobState::kCancelled, now, "cancelled");
    return {};
  });
  // It ended just before.
  if (!cancelled && !changed && cancelled.error().code == ErrorCode::kConflict) return Get(id);
  return cancelled;
}

// Running jobs whose lease has run out: over SQLite, at the start, all.
Result<std::size_t> JobStore::RequeueLost(const std::string& why) {
  const auto lock = LockChanges();
  const bool all = !shared_ && why != kLeaseRanOut;
  std::vector<std::string> ids;
  {
    Session session = parts_.database.Read();
    const auto now = session.Now();
    if (!now) return Forward(now);
    const Timestamp until = all ? Timestamp::max() : *now;
    auto listed = session.Query(
        "SELECT id FROM jobs WHERE state = 1 AND (lease_until <= ?1 OR lease_until IS NULL)"
        " ORDER BY number",
        [&](const Row& row) { ids.push_back(row.Text(0)); }, ToMillis(until));
    if (!listed) return Forward(listed);
  }
  std::size_t count = 0;
  for (const std::string& id : ids) {
    auto queued = ApplyLocked(id, [&](Job& job, Timestamp now) -> Result<void> {
      const bool lost =
          job.state == JobState::kRunning && (all || !job.lease_until || *job.lease_until <= now);
      // Another process was quicker.
      if (!lost) return Fail(ErrorCode::kConflict, "job " + job.id + ": is not lost");
      Requeue(job, now, why);
      return {};
    });
    if (queued) ++count;
    if (!queued && queued.error().code != ErrorCode::kConflict) return Forward(queued);
  }
  return count;
}

Result<std::size_t> JobStore::ExpireLeases() { return RequeueLost(kLeaseRanOut); }

}  // namespace strata::server
