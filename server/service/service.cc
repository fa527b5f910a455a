#include "server/service/service.h"

#include <algorithm>
#include <chrono>
#include <utility>

#include "server/service/job_process.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {

constexpr int kRetryAfter = 1;        // Seconds; requests in flight are mostly short.
constexpr int kRetryAfterDrain = 10;  // About what a restart takes.

internal::WorkerJob JobOf(const v1::SampleOptions& options, const std::string& name,
                          const ServiceLimits& limits, const std::string& scratch) {
  internal::WorkerJob job;
  *job.mutable_options() = options;
  job.set_input_name(name);
  job.set_scratch(scratch);
  const std::uint64_t memory = options.has_memory() ? options.memory() : limits.job_memory_bytes;
  job.set_memory_bytes(std::min(memory, limits.job_memory_bytes));
  const std::uint32_t threads = options.threads() > 0 ? options.threads() : limits.job_threads;
  job.set_threads(std::min(threads, limits.job_threads));
  job.set_seconds(limits.job_seconds);
  job.set_result_bytes(limits.result_bytes);
  return job;
}

const char* OutcomeOf(const Result<v1::SampleSummary>& outcome) {
  if (outcome) return "succeeded";
  return outcome.error().code == ErrorCode::kCancelled ? "cancelled" : "failed";
}

}  // namespace

Answer<void> Upload::Append(std::string_view bytes) {
  if (bytes.size() > limit_ - std::min(limit_, file_->size())) {
    return Refuse(Refusal::kBodyTooLarge,
                  "the body is larger than the " + std::to_string(limit_) + " bytes allowed");
  }
  if (const auto written = file_->Append(bytes); !written) return Refuse(written.error());
  return {};
}

Service::Service(const ServiceLimits& limits, ApiKeys keys, std::unique_ptr<ScratchFolder> scratch,
                 Metrics& metrics)
    : limits_(limits),
      keys_(std::move(keys)),
      scratch_(std::move(scratch)),
      metrics_(metrics),
      admission_(limits.jobs, [&metrics](auto running, auto waiting, auto bytes) {
        metrics.SetJobs(running, waiting, bytes);
      }) {}

Answer<RequestSlot> Service::Enter() {
  if (draining_) {
    return Refuse(Refusal::kUnavailable, "the service is shutting down", kRetryAfterDrain);
  }
  if (in_flight_.fetch_add(1) >= limits_.requests) {
    in_flight_.fetch_sub(1);
    return Refuse(Refusal::kTooMany,
                  std::to_string(limits_.requests) + " requests are in flight, which is the limit",
                  kRetryAfter);
  }
  return RequestSlot(in_flight_);
}

Answer<Upload> Service::BeginUpload() {
  auto file = scratch_->NewFile();
  if (!file) return Refuse(file.error());
  return Upload(*std::move(file), limits_.body_bytes);
}

Answer<StoredService*> Service::stored() const {
  if (stored_) return stored_;
  return Refuse(Refusal::kNotImplemented,
                "this service keeps no models and no jobs: it was started without --data");
}

Answer<BatchService*> Service::batches() const {
  if (batches_) return batches_;
  return Refuse(Refusal::kNotImplemented,
                "this service has no repository of models: it was started without --models");
}

Answer<Sampled> Service::Sample(const v1::SampleOptions& options, int mesh, const std::string& name,
                                const JobWatch& watch) {
  if (const auto checked = CommandOf(options, "-", "-"); !checked) return Refuse(checked.error());
  internal::WorkerJob job = JobOf(options, name, limits_, scratch_->path());
  job.set_checkpoint_folder(watch.checkpoint_folder);
  job.set_checkpoint_key(watch.checkpoint_key);
  JobWatch either = watch;
  either.gone = [this, &watch] { return cancelled_ || (watch.gone && watch.gone()); };
  if (watch.progress) {
    v1::Progress queued;
    queued.set_stage(v1::Progress::queue);
    watch.progress(queued);
  }
  const auto ticket =
      admission_.Enter(job.memory_bytes(), either.gone,
                       watch.accepted ? Admission::Full::kWait : Admission::Full::kRefuse);
  if (!ticket) return Pass(ticket);
  return Run(job, mesh, either);
}

Answer<Sampled> Service::Run(const internal::WorkerJob& job, int mesh, const JobWatch& watch) {
  auto made = scratch_->NewFile();
  if (!made) return Refuse(made.error());
  const std::shared_ptr<const ScratchFile> result = *std::move(made);
  const int output = result->descriptor();
  const auto start = std::chrono::steady_clock::now();
  auto outcome = limits_.isolate ? RunJobIsolated(job, mesh, output, watch)
                                 : RunJobInProcess(job, mesh, output, watch);
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
  metrics_.CountJob(OutcomeOf(outcome), spent.count(), outcome ? outcome->samples() : 0);
  if (!outcome) return Refuse(outcome.error());
  Sampled sampled;
  sampled.content.read = [result](std::uint64_t offset, std::span<char> out) {
    return result->ReadAt(offset, out);
  };
  sampled.content.size = outcome->size_bytes();
  sampled.content.media_type = outcome->media_type();
  sampled.summary = *std::move(outcome);
  return sampled;
}

}  // namespace strata::server
