// The queue of jobs, on disk.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/database.h"
#include "server/store/job.h"
#include "server/store/job_events.h"

namespace strata::server {

struct JobLimits {
  std::uint64_t max_queued = 1000;
  /// A job claimed that often without an end has failed: it may be what kills its processes.
  /// 0: never.
  std::int64_t max_attempts = 20;  // Where processes are many, 3 are enough: see serve_config.cc.
  Milliseconds lease = std::chrono::seconds(30);  ///< How long a claim lasts without a Heartbeat.
};

struct CreatedJob {
  Job job;
  bool created = false;  ///< False: the idempotency key named it, nothing was made.
};

/// The right to work on a job: of the attempt it was given for, until that lease runs out.
struct JobClaim {
  std::string id;
  std::int64_t attempt = 0;
};

struct JobQuery {
  std::vector<JobState> states;  ///< Empty: all.
  std::optional<std::string> model;
  std::optional<std::string> client;
  std::optional<Timestamp> created_from;    ///< Inclusive.
  std::optional<Timestamp> created_before;  ///< Exclusive.
  std::size_t size = 100;                   ///< 1 to 1000 jobs a page.
  std::string page_token;                   ///< The last page's `next`; "" for the first page.
};

struct JobPage {
  std::vector<Job> jobs;  ///< The latest first.
  std::string next;       ///< "" on the last page.
};

/// Jobs: queued, then running, then succeeded, failed or cancelled. A job runs for one owner at a
/// time: claims are fenced by their attempt. A job is finished in one transaction that names its
/// result, whose blob is durable before: after a crash it is finished with its whole result, or
/// queued again. Threads: any; every change is on disk when its call returns.
class JobStore {
 public:
  struct Parts {
    Database& database;
    BlobStore& blobs;
    const Clock& clock;
  };
  /// Over SQLite there is one process, so jobs that run by the database's account run no more: they
  /// are queued again, or cancelled where that was asked for. In a shared store they are other
  /// processes', until their leases run out. Everything outlives the store. Errors: kIo.
  static Result<std::unique_ptr<JobStore>> Open(const Parts& parts, const JobLimits& limits);

  /// With an idempotency key that the client has used before: that job, if model and options are
  /// the same. Keys are kept as long as their jobs. Errors: kConflict (another request has the
  /// key), kOverBudget (the queue is full), kInvalidArgument (a limit of JobRequest), kIo.
  Result<CreatedJob> Create(const JobRequest& request);
  /// Errors: kNotFound, kIo.
  Result<Job> Get(const std::string& id);
  /// As ModelStore::List: new jobs never move another one out of a page.
  Result<JobPage> List(const JobQuery& query);

  /// A queued job is cancelled at once; of a running one its owner is told by Heartbeat; a finished
  /// one stays as it is. Returns the job as it is then. Errors: kNotFound, kIo.
  Result<Job> Cancel(const std::string& id);

  struct Claimed {
    Job job;
    JobClaim claim;
  };
  /// The oldest queued job, running from now on; nothing if none is queued. Errors: kIo.
  Result<std::optional<Claimed>> Claim(const std::string& owner);
  /// Waits up to `timeout` until a job is queued. Whether one is.
  bool WaitForQueued(Milliseconds timeout);
  /// How often jobs were put into the queue, as far as this process has heard. For a worker that
  /// found nothing to claim: it waits for the next time.
  std::uint64_t arrivals() const;
  /// Waits up to `timeout` until arrivals() is another than `seen`.
  void WaitForArrival(std::uint64_t seen, Milliseconds timeout);

  /// Extends the lease and tells followers of the progress. Once a second is often enough.
  /// Returns whether the job goes on; if not, it is to be ended with MarkCancelled.
  /// Errors: kConflict when the claim is not valid any more: the work is in vain; kIo.
  Result<bool> Heartbeat(const JobClaim& claim, const JobProgress& progress);
  /// Each ends the job. `result.hash` and `size` are taken from `blob`. If cancelling was asked for
  /// meanwhile, the result counts. Errors: as Heartbeat.
  Result<Job> Succeed(const JobClaim& claim, const BlobPin& blob, JobResult result);
  Result<Job> MarkFailed(const JobClaim& claim, const Error& error);
  Result<Job> MarkCancelled(const JobClaim& claim);
  /// Puts the job back into the queue at its old place: the process is about to end.
  Result<Job> Release(const JobClaim& claim);
  /// The same after an attempt that failed and counts: the last of JobLimits::max_attempts ends the
  /// job as failed, with `error`.
  Result<Job> TryAgain(const JobClaim& claim, const Error& error);

  /// Jobs whose lease has run out are queued again. Returns how many. Errors: kIo.
  Result<std::size_t> ExpireLeases();
  /// Forgets at most `count` jobs that finished before `time`, and their results unless the cache
  /// has them. Returns how many. Errors: kIo.
  Result<std::size_t> Purge(Timestamp time, std::size_t count = 1000);

  /// Follows a job. If it has changed since the change number `after` (0: in any case), its present
  /// state comes first; what was in between does not come. For `on_event` see JobSubscription.
  /// Errors: kNotFound, kIo.
  Result<std::shared_ptr<JobSubscription>> Subscribe(const std::string& id, std::uint64_t after = 0,
                                                     std::function<void()> on_event = {});

  /// The job once it is finished, or as it is after `timeout` of the machine's time.
  /// Errors: kNotFound, kIo.
  Result<Job> WaitForEnd(const std::string& id, Milliseconds timeout);

  /// In a shared store counted by the database; 0 when it is away.
  std::uint64_t queued() const;
  std::uint64_t running() const;

  /// In a shared store: what its triggers tell (schema.cc).
  void HearOfJob(const std::string& text);
  void HearOfQueue();
  /// Something may have been missed: tells followers how their jobs are, and wakes workers.
  void Look();

 private:
  using Change = std::function<Result<void>(Job& job, Timestamp now)>;
  JobStore(const Parts& parts, const JobLimits& limits)
      : parts_(parts), limits_(limits), shared_(parts.database.shared()) {}

  Result<void> CountStates();
  Result<CreatedJob> CreateLocked(const JobRequest& request);
  Result<Job> Apply(const std::string& id, const Change& change);
  Result<Job> ApplyLocked(const std::string& id, const Change& change);
  Result<void> Write(Session& session, Job& job, const Change& change, Timestamp now);
  void Tell(JobState before, const Job& job);
  Result<std::uint64_t> CountState(JobState state) const;
  Result<Job> End(const JobClaim& claim, const Change& change);
  Result<std::size_t> RequeueLost(const std::string& why);
  /// `error`: of the attempt, if it is what a last one leaves.
  void Requeue(Job& job, Timestamp now, const std::string& why,
               const std::optional<Error>& error = {}) const;
  static void Finish(Job& job, JobState state, Timestamp now, const std::string& why);
  void Count(JobState from, JobState to);

  /// Held over each change and the telling of it, so that followers see every change. Taken before
  /// the locks of blobs and database. In a shared store others change jobs meanwhile anyway, and
  /// what comes late is dropped: there nobody waits for it.
  std::unique_lock<std::mutex> LockChanges() {
    return shared_ ? std::unique_lock<std::mutex>() : std::unique_lock(changes_);
  }

  Parts parts_;
  JobLimits limits_;
  const bool shared_;
  JobEvents events_;
  std::mutex changes_;
  mutable std::mutex mutex_;  // Guards what follows.
  std::condition_variable queued_came_;
  std::uint64_t queued_ = 0, running_ = 0;  // Of SQLite.
  std::uint64_t arrivals_ = 0;
};

}  // namespace strata::server
