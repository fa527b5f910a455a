// The jobs' part of StoredService.
#include <algorithm>

#include "server/service/canonical_options.h"
#include "server/service/stored_messages.h"
#include "server/service/stored_results.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kTick{50};

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
/// that a crash of the machine damaged, or a process that they brought down.
bool MayBeDamage(ErrorCode code) { return code == ErrorCode::kIo || code == ErrorCode::kInternal; }

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
  while (true) {
    const auto left =
        std::chrono::ceil<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    const auto job = store_->jobs().WaitForEnd(id, std::clamp(left, {}, kTick));
    if (!job) return Refuse(job.error());
    if (IsFinished(job->state) || left <= kTick || gone() || service_.cancelled()) {
      return MessageOf(*job);
    }
  }
}

Answer<void> StoredService::WatchJob(const v1::WatchJobRequest& request,
                                     const std::function<bool(const v1::JobEvent&)>& tell,
                                     const std::function<bool()>& gone) {
  const auto following = store_->jobs().Subscribe(request.id(), request.after_sequence());
  if (!following) return Refuse(following.error());
  JobSubscription& events = **following;
  std::uint64_t told = request.after_sequence();
  while (!events.ended()) {
    JobEvent event = events.Next(kTick);
    if (gone() || service_.cancelled()) return {};
    if (!event) {
      // It had ended before, or ends just now, and its last event is on the way.
      const auto job = store_->jobs().Get(request.id());
      if (!job) return {};
      if (!IsFinished(job->state)) continue;
      if (job->sequence <= told) return {};
      event = std::make_shared<const Job>(*job);
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
  while (!stopping_) {
    // Bounded, so that the end of the service is noticed.
    if (!store_->jobs().WaitForQueued(std::chrono::milliseconds(200)) || stopping_) continue;
    const auto claimed = store_->jobs().Claim("serve");
    if (claimed && *claimed) RunClaimed(**claimed);
  }
}

void StoredService::RunClaimed(const JobStore::Claimed& claimed) {
  JobStore& jobs = store_->jobs();
  const Job& job = claimed.job;
  v1::Progress latest;
  bool cancelled = false, lost = false;
  auto beat = std::chrono::steady_clock::now();
  JobWatch watch;
  watch.progress = [&latest](const v1::Progress& progress) { latest = progress; };
  watch.gone = [&] {
    if (std::chrono::steady_clock::now() >= beat) {
      beat = std::chrono::steady_clock::now() + std::chrono::milliseconds(500);
      const auto goes_on = jobs.Heartbeat(claimed.claim, ProgressOf(latest));
      lost = !goes_on && goes_on.error().code == ErrorCode::kConflict;
      cancelled = goes_on && !*goes_on;
    }
    return cancelled || lost || stopping_;
  };
  watch.checkpoint_folder = checkpoints_->folder();
  watch.checkpoint_key = checkpoints_->KeyOf(job);
  const bool goes_on = checkpoints_->Has(watch.checkpoint_key);
  auto outcome = RunAttempt(job, watch);
  const bool wanted = !cancelled && !lost && !stopping_;
  if (!outcome && goes_on && wanted && MayBeDamage(outcome.error().code)) {
    checkpoints_->Remove(watch.checkpoint_key);
    outcome = RunAttempt(job, watch);
  }
  EndClaimed(claimed.claim, outcome, cancelled, lost);
  const auto ended = jobs.Get(job.id);
  if (ended && IsFinished(ended->state)) checkpoints_->Remove(watch.checkpoint_key);
}

Answer<Sampled> StoredService::RunAttempt(const Job& job, const JobWatch& watch) {
  v1::SampleOptions options;
  if (auto parsed = FromJson(job.request.options, options); !parsed) return Refuse(parsed.error());
  const auto model = store_->models().OpenVersion(job.request.model, job.request.model_hash);
  if (!model) return Refuse(model.error());
  return SampleOpened(options, *model, watch);
}

void StoredService::EndClaimed(const JobClaim& claim, const Answer<Sampled>& outcome,
                               bool cancelled, bool lost) {
  JobStore& jobs = store_->jobs();
  if (lost) return;  // Somebody else's by now.
  if (outcome) {
    const std::string& etag = outcome->content.etag;
    const auto pin = store_->blobs().Pin(etag.substr(1, etag.size() - 2));
    JobResult result;
    result.media_type = outcome->content.media_type;
    result.summary = JsonOf(outcome->summary);
    // Where this fails the lease runs out, and the job runs again.
    if (pin) static_cast<void>(jobs.Succeed(claim, *pin, std::move(result)));
    return;
  }
  const Problem& problem = outcome.error();
  if (cancelled) {
    static_cast<void>(jobs.MarkCancelled(claim));
  } else if (stopping_ || problem.code == ErrorCode::kCancelled) {
    static_cast<void>(jobs.Release(claim));
  } else {
    static_cast<void>(jobs.MarkFailed(claim, {problem.code, problem.detail}));
  }
}

}  // namespace strata::server
