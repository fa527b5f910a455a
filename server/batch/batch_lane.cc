#include "server/batch/batch_lane.h"

#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "core/stopwatch.h"
#include "core/version.h"
#include "server/exit_codes.h"
#include "server/service/job_process.h"

namespace strata::server {
namespace {

constexpr std::uint64_t kMiB = std::uint64_t{1} << 20;
constexpr std::uint64_t kOwnBytes = 72 * kMiB;     // Of this process, libraries included.
constexpr std::uint64_t kWorkerBytes = 56 * kMiB;  // Of a worker beside its job's.
constexpr int kJobsOfAWorker = 500;
constexpr std::uint64_t kGrownBytes = 160 * kMiB;
constexpr int kTickMs = 50;
constexpr int kPictureWidth = 320, kPictureHeight = 240;

ManifestLine LineOf(const BatchTask& task) {
  ManifestLine line;
  line.path = task.model->path;
  line.stamp = task.model->stamp;
  line.input_bytes = task.model->size;
  line.version = kVersion;
  line.options = task.options->json;
  line.measured.attempts = task.attempt;
  return line;
}

TaskOutcome Failed(ManifestLine line, std::string type, std::string message, bool not_its_fault) {
  TaskOutcome outcome;
  outcome.line = std::move(line);
  outcome.line.error_type = std::move(type);
  outcome.line.error_message = std::move(message);
  outcome.not_its_fault = not_its_fault;
  return outcome;
}

TaskOutcome Failed(const BatchTask& task, const Error& error) {
  if (error.code == ErrorCode::kCancelled) return {TaskOutcome::Kind::kGone, {}, false};
  // Memory may be short because others ran beside it; a disk may be full for a while.
  const bool short_of_memory = error.code == ErrorCode::kOverBudget && !task.whole_machine;
  return Failed(LineOf(task), ExitCodeOf(error.code).type, error.message,
                error.code == ErrorCode::kIo || short_of_memory);
}

/// What the end of a worker that said nothing means for its model.
TaskOutcome Lost(const BatchTask& task, const internal::WorkerJob& job, int status) {
  const int signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
  if (signal == SIGXCPU) return Failed(task, ErrorOfEnd(job, status));
  if (signal == SIGKILL || signal == SIGTERM || signal == SIGINT || signal == SIGHUP) {
    return Failed(LineOf(task), "killed",
                  "its worker was ended by signal " + std::to_string(signal) +
                      ": from outside, or by the system because memory was short",
                  true);
  }
  const std::string how = signal != 0 ? "signal " + std::to_string(signal)
                                      : "exit status " + std::to_string(WEXITSTATUS(status));
  return Failed(LineOf(task), "crashed", "its worker crashed with " + how, false);
}

void AddCompanions(const internal::WorkerFigures& figures, ManifestLine& line) {
  for (const internal::Companion& each : figures.companions()) {
    if (IsModelPath(each.path())) {
      line.companions.push_back({each.path(), each.bytes(), each.stamp()});
    }
  }
}

void AddSummary(const v1::SampleSummary& summary, ManifestLine& line) {
  line.samples = summary.samples();
  line.cells = summary.cells();
  line.edge = summary.edge();
  line.surface_hash = summary.surface_hash();
  line.output_bytes = summary.size_bytes();
  const auto json = nlohmann::json::parse(summary.json());
  json.at("mesh").at("sampled").get_to(line.triangles);
  json.at("mesh").at("area").get_to(line.area);
  for (const auto& [reason, count] : json.at("mesh").at("skipped").items()) {
    if (count != 0) line.skipped[reason] = count;
  }
  json.at("left_out").get_to(line.left_out);
}

}  // namespace

MemoryParts DivideMemory(std::uint64_t memory_bytes, std::uint32_t jobs, std::size_t models) {
  const std::uint64_t theirs = memory_bytes - kOwnBytes;
  const std::uint64_t fit = theirs / (kWorkerBytes + kLeastMemory);
  const std::uint64_t wanted = std::min<std::uint64_t>(jobs, std::max<std::size_t>(models, 1));
  MemoryParts parts;
  parts.lanes = static_cast<std::uint32_t>(
      std::clamp<std::uint64_t>(wanted, 1, std::max<std::uint64_t>(fit, 1)));
  parts.small_bytes = theirs / parts.lanes - kWorkerBytes;
  parts.whole_bytes = std::max(kLeastMemory, theirs - parts.lanes * kWorkerBytes);
  return parts;
}

internal::WorkerJob BatchLane::JobOf(const BatchTask& task, const std::string& input,
                                     const std::string& output) const {
  internal::WorkerJob job;
  *job.mutable_options() = task.options->options;
  job.set_input_name(task.model->path);
  job.set_input(input);
  job.set_output(output);
  job.set_hash(true);
  job.set_known_sha256(task.known_sha256);
  job.set_memory_bytes(task.whole_machine ? shop_.memory.whole_bytes : shop_.memory.small_bytes);
  job.set_threads(task.whole_machine ? shop_.command.jobs : shop_.small_threads);
  job.set_seconds(shop_.command.timeout_seconds);
  job.set_result_bytes(std::numeric_limits<std::uint64_t>::max());
  job.set_scratch(shop_.command.scratch.value_or(""));
  job.set_simd(shop_.command.simd);
  if (!task.picture.empty()) {
    job.set_picture(shop_.state + '/' + task.picture);
    job.set_picture_width(kPictureWidth);
    job.set_picture_height(kPictureHeight);
  }
  return job;
}

TaskOutcome BatchLane::Run(const BatchTask& task) {
  const Stopwatch watch;
  const auto model = shop_.source.Fetch(*task.model, shop_.gone);
  TaskOutcome outcome = model ? RunFetched(task, *model) : Failed(task, model.error());
  outcome.line.measured.seconds = watch.seconds();
  outcome.line.measured.finished = InstantNow();
  return outcome;
}

TaskOutcome BatchLane::RunFetched(const BatchTask& task, const LocalModel& model) {
  const std::string output = task.model->path + task.options->suffix;
  const auto path = shop_.outputs.LocalPath(output);
  if (!path) return Failed(task, path.error());
  if (!worker_.started()) {
    if (auto started = worker_.Start(-1, -1); !started) return Failed(task, started.error());
    jobs_done_ = 0;
  }
  const pid_t worker = worker_.id();
  const internal::WorkerJob job = JobOf(task, model.path, *path);
  worker_.Send(job);
  TaskOutcome outcome = Hear(task, job);
  outcome.line.measured.worker = worker;
  // What is a copy lies alone.
  if (model.keep != nullptr) outcome.line.companions.clear();
  if (!worker_.started()) shop_.outputs.Discard(output);
  if (outcome.kind != TaskOutcome::Kind::kSampled) return outcome;
  outcome.line.output = output;
  outcome.line.picture = task.picture;
  if (auto published = shop_.outputs.Publish(output, shop_.gone); !published) {
    return Failed(task, published.error());
  }
  return outcome;
}

TaskOutcome BatchLane::Hear(const BatchTask& task, const internal::WorkerJob& job) {
  const Stopwatch watch;
  while (!worker_.ended()) {
    const auto event = worker_.Next(kTickMs);
    if (event && !event->has_progress()) {
      TaskOutcome outcome;
      if (event->has_failed()) {
        outcome = Failed(task, ErrorOf(event->failed()));
      } else {
        const bool unchanged = event->figures().unchanged();
        outcome.kind = unchanged ? TaskOutcome::Kind::kUnchanged : TaskOutcome::Kind::kSampled;
        outcome.line = LineOf(task);
        outcome.line.sampled = true;
        if (!unchanged) AddSummary(event->done(), outcome.line);
      }
      outcome.line.input_sha256 = event->figures().input_sha256();
      outcome.line.output_sha256 = event->figures().output_sha256();
      AddCompanions(event->figures(), outcome.line);
      outcome.line.measured.peak_memory_bytes = event->figures().peak_memory_bytes();
      RecycleIfGrown(event->figures());
      return outcome;
    }
    if (shop_.gone()) {
      worker_.Kill();
      return {TaskOutcome::Kind::kGone, {}, false};
    }
    if (watch.seconds() > shop_.command.timeout_seconds) {
      worker_.Kill();
      return Failed(LineOf(task), "timed-out",
                    "it did not end within the " + std::to_string(shop_.command.timeout_seconds) +
                        " seconds of --timeout",
                    false);
    }
  }
  return Lost(task, job, worker_.Wait());
}

/// What jobs leave in a process adds up: an allocator's arenas, a library's leak.
void BatchLane::RecycleIfGrown(const internal::WorkerFigures& figures) {
  if (++jobs_done_ < kJobsOfAWorker && figures.resident_bytes() < kGrownBytes) return;
  worker_.Kill();
}

}  // namespace strata::server
