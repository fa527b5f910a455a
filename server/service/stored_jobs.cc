// The jobs' part of StoredService.
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <utility>

#include "server/service/canonical_options.h"
#include "server/service/log.h"
#include "server/service/stored_messages.h"
#include "server/service/stored_results.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr int kForgottenTicks = 200;
constexpr std::chrono::milliseconds kBeatEvery{500};
constexpr std::chrono::milliseconds kAwayPause{200};

/// Gates what gRPC lets through and JSON does not: counted in milliseconds, it would overflow.
bool IsTime(const google::protobuf::Timestamp& time) {
  using google::protobuf::util::TimeUtil;
  return time.seconds() >= TimeUtil::kTimestampMinSeconds &&
         time.seconds() <= TimeUtil::kTimestampMaxSeconds && time.nanos() >= 0 &&
         time.nanos() < 1'000'000'000;
}

JobQuery QueryOf(const v1::ListJobsRequest& request) {
  JobQuery query;
  for (const int state : request.state()) {
    query.states.push_back(StateOf(static_cast<v1::Job::State>(state)));
  }
  if (!request.model().empty()) query.model = request.model();
  if (request.has_created_after()) query.created_from = TimeOf(request.created_after());
  if (request.has_created_before()) query.created_before = TimeOf(request.created_before());
  if (request.page_size() > 0) query.size = request.page_size();
  query.page_token = request.page_token();
  return query;
}

/// Whether an attempt that went on from a former one's checkpoint may have failed by that: files
/// that a crash of the machine damaged, or a process that they brought down. Not what the database
/// or the bucket had to say.
bool MayBeDamage(const Error& error) {
  return (error.code == ErrorCode::kIo || error.code == ErrorCode::kInternal) &&
         !IsStoreAway(error) && !IsObjectRefused(error);
}

/// The error that a problem came from.
Error ErrorOf(const Problem& problem) { return {problem.code, problem.detail, problem.kind}; }

}  // namespace

Answer<StoredService::CreatedJob> StoredService::CreateJob(const v1::CreateJobRequest& request,
                                                           const std::string& client) {
  const auto options = Canonical(request.options());
  if (!options) return Refuse(options.error());
  const auto model = store_->models().Get(request.model());
  if (!model) return Refuse(model.error());
  JobRequest job;
  job.model = model->name;
  job.model_hash = model->hash;
  job.options = JsonOf(*options);
  job.result_key = ResultKeyOf(*options, model->hash);
  job.client = client;
  job.idempotency_key = request.idempotency_key();
  const auto created = store_->jobs().Create(job);
  if (!created && created.error().code == ErrorCode::kOverBudget) {
    return Refuse(Refusal::kUnavailable, created.error().message, 10);  // The queue is full.
  }
  if (!created) return Refuse(created.error());
  return CreatedJob{MessageOf(created->job), created->created};
}

Answer<v1::Job> StoredService::GetJob(const std::string& id) {
  const auto job = store_->jobs().Get(id);
  if (!job) return Refuse(job.error());
  return MessageOf(*job);
}

Answer<v1::ListJobsResponse> StoredService::ListJobs(const v1::ListJobsRequest& request) {
  for (const int state : request.state()) {
    if (state < v1::Job::queued || state > v1::Job::cancelled) {
      return Refuse(Error{ErrorCode::kInvalidArgument,
                          "state: expected queued, running, succeeded, failed or cancelled"});
    }
  }
  for (const auto& [given, time] :
       {std::pair(request.has_created_after(), &request.created_after()),
        std::pair(request.has_created_before(), &request.created_before())}) {
    if (given && !IsTime(*time)) {
      return Refuse(Error{ErrorCode::kInvalidArgument,
                          "created_after, created_before: expected an instant of the years 1 to "
                          "9999"});
    }
  }
  const auto page = store_->jobs().List(QueryOf(request));
  if (!page) return Refuse(page.error());
  v1::ListJobsResponse response;
  for (const Job& job : page->jobs) *response.add_jobs() = MessageOf(job);
  response.set_next_page_token(page->next);
  return response;
}

Answer<v1::Job> StoredService::CancelJob(const std::string& id) {
  const auto job = store_->jobs().Cancel(id);
  if (!job) return Refuse(job.error());
  return MessageOf(*job);
}

Answer<v1::Job> StoredService::WaitJob(const std::string& id, std::chrono::milliseconds timeout,
                                       const std::function<bool()>& gone) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  const auto following = store_->jobs().Subscribe(id);
  if (!following) return Refuse(following.error());
  JobEvent latest;
  while (true) {
    const auto left =
        std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    if (const JobEvent event = (*following)->Next(std::clamp(left, {}, kTick))) latest = event;
    const bool over = (*following)->ended() || left <= kTick || gone() || service_.cancelled();
    if (over && latest) return MessageOf(*latest);
  }
}

Answer<void> StoredService::WatchJob(const v1::WatchJobRequest& request,
                                     const std::function<bool(const v1::JobEvent&)>& tell,
                                     const std::function<bool()>& gone) {
  const auto following = store_->jobs().Subscribe(request.id(), request.after_sequence());
  if (!following) return Refuse(following.error());
  JobSubscription& events = **following;
  std::uint64_t told = request.after_sequence();
  int idle = 0;
  while (!events.ended()) {
    const JobEvent event = events.Next(kTick);
    if (gone() || service_.cancelled()) return {};
    if (!event) {
      // It may have been forgotten, its last event with it.
      if (++idle % kForgottenTicks != 0) continue;
      const auto job = store_->jobs().Get(request.id());
      if (!job && job.error().code == ErrorCode::kNotFound) return {};
      continue;
    }
    if (event->sequence <= told) continue;
    told = event->sequence;
    v1::JobEvent message;
    message.set_sequence(event->sequence);
    *message.mutable_job() = MessageOf(*event);
    if (!tell(message)) return {};
  }
  return {};
}

Answer<Sampled> StoredService::OpenResult(const std::string& id) {
  const auto job = store_->jobs().Get(id);
  if (!job) return Refuse(job.error());
  if (!job->result) {
    return Refuse(Error{
        ErrorCode::kConflict,
        "the job has no result: it is " + v1::Job::State_Name(static_cast<int>(job->state) + 1)});
  }
  auto blob = store_->blobs().OpenBlob(job->result->hash);
  if (!blob) return Refuse(blob.error());
  Sampled sampled;
  sampled.summary = MessageOf(*job).summary();
  sampled.content = ContentOf(*std::move(blob), job->result->media_type);
  return sampled;
}

// --- Working them off ----------------------------------------------------------------------------

void StoredService::RunJobs() {
  JobStore& jobs = store_->jobs();
  while (!stopping_) {
    // Before the look: what comes after it ends the wait.
    const std::uint64_t seen = jobs.arrivals();
    Result<std::optional<JobStore::Claimed>> claimed = std::nullopt;
    const bool away = store_->bucket_is_away();  // Without it no job comes far.
    if (claiming_ && !away) claimed = jobs.Claim(owner_);
    if (claimed && *claimed) {
      ++running_;
      RunClaimed(**claimed);
      --running_;
      continue;
    }
    // Bounded, so that the end of the service is noticed.
    for (auto waited = kAwayPause; jobs.arrivals() == seen && !stopping_; waited += kAwayPause) {
      jobs.WaitForArrival(seen, kAwayPause);
      // The look failed, or there was none: once more.
      if ((!claimed || away) && waited >= 5 * kAwayPause) break;
    }
  }
}

void StoredService::Beat(const JobClaim& claim, const v1::Progress& latest, Fate& fate) {
  const auto begun = std::chrono::steady_clock::now();
  const auto goes_on = store_->jobs().Heartbeat(claim, ProgressOf(latest));
  if (goes_on) {
    fate.lease_end = begun + lease_;
    fate.cancelled = !*goes_on;
    return;
  }
  const ErrorCode code = goes_on.error().code;
  fate.lost = code == ErrorCode::kConflict || code == ErrorCode::kNotFound ||
              std::chrono::steady_clock::now() >= fate.lease_end;
}

void StoredService::RunClaimed(const JobStore::Claimed& claimed) {
  const Job& job = claimed.job;
  v1::Progress latest;
  Fate fate;
  fate.lease_end = std::chrono::steady_clock::now() + lease_;
  auto beat = std::chrono::steady_clock::now();
  JobWatch watch;
  watch.progress = [&latest](const v1::Progress& progress) { latest = progress; };
  watch.gone = [&] {
    if (std::chrono::steady_clock::now() >= beat) {
      Beat(claimed.claim, latest, fate);
      beat = std::chrono::steady_clock::now() + std::min(kBeatEvery, lease_ / 4);
    }
    return fate.cancelled || fate.lost || stopping_;
  };
  watch.accepted = true;
  if (checkpoints_) {
    watch.checkpoint_folder = checkpoints_->folder();
    watch.checkpoint_key = checkpoints_->KeyOf(job);
  }
  const bool goes_on = checkpoints_ && checkpoints_->Has(watch.checkpoint_key);
  auto outcome = RunAttempt(job, watch);
  const bool wanted = !fate.cancelled && !fate.lost && !stopping_;
  if (!outcome && goes_on && wanted && MayBeDamage(ErrorOf(outcome.error()))) {
    checkpoints_->Remove(watch.checkpoint_key);
    outcome = RunAttempt(job, watch);
  }
  EndClaimed(claimed.claim, outcome, fate);
  if (!checkpoints_) return;
  const auto ended = store_->jobs().Get(job.id);
  if (ended && IsFinished(ended->state)) checkpoints_->Remove(watch.checkpoint_key);
}

Answer<Sampled> StoredService::RunAttempt(const Job& job, const JobWatch& watch) {
  v1::SampleOptions options;
  if (auto parsed = FromJson(job.request.options, options); !parsed) return Refuse(parsed.error());
  // Heartbeats go on while the bucket is waited for.
  const Meanwhile meanwhile(watch.gone);
  return SampleVersion(options, {job.request.model, job.request.model_hash}, watch);
}

void StoredService::EndClaimed(const JobClaim& claim, const Answer<Sampled>& outcome,
                               const Fate& fate) {
  if (fate.lost) {
    Log(LogLevel::kWarning, "lease_lost",
        {{"job", claim.id}, {"attempt", static_cast<std::uint64_t>(claim.attempt)}});
    return;  // Somebody else's by now. What was made goes as every blob that nothing refers to.
  }
  while (true) {
    const auto ended = EndOnce(claim, outcome, fate);
    if (ended) return;
    const bool again = IsDatabaseAway(ended.error()) && !stopping_ &&
                       std::chrono::steady_clock::now() < fate.lease_end;
    if (!again) {
      // The lease runs out, and the job runs again.
      Log(LogLevel::kWarning, "job_not_ended",
          {{"job", claim.id},
           {"attempt", static_cast<std::uint64_t>(claim.attempt)},
           {"reason", ended.error().message}});
      return;
    }
    std::unique_lock lock(mutex_);
    wake_.wait_for(lock, kAwayPause);
  }
}

Result<void> StoredService::EndOnce(const JobClaim& claim, const Answer<Sampled>& outcome,
                                    const Fate& fate) {
  JobStore& jobs = store_->jobs();
  const auto as_void = [](const Result<Job>& ended) {
    return ended ? Result<void>() : Result<void>(Forward(ended));
  };
  if (outcome) {
    const std::string& etag = outcome->content.etag;
    const auto pin = store_->blobs().Pin(etag.substr(1, etag.size() - 2));
    if (!pin) return Forward(pin);
    JobResult result;
    result.media_type = outcome->content.media_type;
    result.summary = JsonOf(outcome->summary);
    return as_void(jobs.Succeed(claim, *pin, std::move(result)));
  }
  const Error error = ErrorOf(outcome.error());
  if (fate.cancelled) return as_void(jobs.MarkCancelled(claim));
  if (stopping_ || IsStoreAway(error) || error.code == ErrorCode::kCancelled) {
    return as_void(jobs.Release(claim));
  }
  if (IsObjectRefused(error)) return as_void(jobs.TryAgain(claim, error));
  return as_void(jobs.MarkFailed(claim, error));
}

}  // namespace strata::server
