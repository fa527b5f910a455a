#include "server/service/job.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <future>
#include <string>

#include "server/sample_command.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {

using SteadyClock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kTick{50};

std::string PathOf(int descriptor) { return "/dev/fd/" + std::to_string(descriptor); }

/// `text` with `path` called `name`.
std::string Renamed(std::string text, const std::string& path, const std::string& name) {
  for (std::size_t at = 0; (at = text.find(path, at)) != std::string::npos; at += name.size()) {
    text.replace(at, path.size(), name);
  }
  return text;
}

v1::SampleSummary SummaryOf(SampleCommand command, const JobReport& report,
                            const std::string& input_name) {
  v1::SampleSummary summary;
  summary.set_samples(report.stats.survivors);
  summary.set_cells(report.stats.cells);
  summary.set_edge(report.stats.lattice.edge);
  summary.set_surface_hash(report.stats.surface_hash);
  const bool tiles =
      command.format == io::SampleFormat::kDraco && report.stats.survivors > command.tile_samples;
  summary.set_media_type(tiles ? kZipMediaType : MediaTypeOf(command.format));
  summary.set_size_bytes(report.figures.write_bytes);
  command.input = input_name;
  command.output = "body";
  summary.set_json(SummaryJson(command, report.stats, report.figures));
  return summary;
}

Result<v1::SampleSummary> Run(SampleCommand command, const std::string& input_name,
                              RunContext& context) {
  JobReport report;
  const auto outcome = RunSample(command, context, &report);
  if (!outcome) {
    const Error& error = outcome.error();
    return Fail(error.code, Renamed(Renamed(error.message, command.input, input_name),
                                    command.output, "the result"));
  }
  return SummaryOf(std::move(command), report, input_name);
}

}  // namespace

Result<v1::SampleSummary> RunJob(const internal::WorkerJob& job, int mesh, int result,
                                 RunContext& context,
                                 std::shared_ptr<const io::CompanionFiles> companions) {
  auto command = CommandOf(job.options(), job.input().empty() ? PathOf(mesh) : job.input(),
                           job.output().empty() ? PathOf(result) : job.output());
  if (!command) return Forward(command);
  if (!job.picture().empty()) {
    command->picture = job.picture();
    command->picture_width = static_cast<int>(job.picture_width());
    command->picture_height = static_cast<int>(job.picture_height());
  }
  if (!job.simd().empty()) command->simd = job.simd();
  command->companions = std::move(companions);
  command->memory = job.memory_bytes();
  command->tiles_in_zip = job.output().empty();  // A body is one file.
  command->checkpoints =
      false;  // But for jobs with a place for them, nothing outlives the process.
  command->checkpoint_folder = job.checkpoint_folder();
  command->checkpoint_key = job.checkpoint_key();
  command->options.threads = static_cast<int>(job.threads());
  if (!job.scratch().empty()) command->scratch = job.scratch();
  return Run(*std::move(command), job.input_name(), context);
}

Result<v1::SampleSummary> RunJobInProcess(const internal::WorkerJob& job, int mesh, int result,
                                          const JobWatch& watch) {
  RunContext context(job.memory_bytes());
  const auto start = SteadyClock::now();
  auto running = std::async(std::launch::async, [&] { return RunJob(job, mesh, result, context); });
  Result<void> kept;
  while (running.wait_for(kTick) != std::future_status::ready) {
    if (watch.progress) watch.progress(ProgressOf(context));
    const double seconds = std::chrono::duration<double>(SteadyClock::now() - start).count();
    if (kept) kept = CheckJobLimits(job, result, seconds);
    if (kept && watch.gone && watch.gone()) kept = Cancelled();
    if (!kept) context.Cancel();
  }
  auto outcome = running.get();
  if (!kept) return Forward(kept);
  return outcome;
}

v1::Progress ProgressOf(const RunContext& context) {
  constexpr std::array<v1::Progress::Stage, 5> kStages = {v1::Progress::open, v1::Progress::scan,
                                                          v1::Progress::reject, v1::Progress::write,
                                                          v1::Progress::write};
  v1::Progress progress;
  progress.set_stage(kStages[static_cast<std::size_t>(context.stage())]);
  progress.set_done(context.done());
  progress.set_total(context.total());
  progress.set_triangles(context.triangles());
  return progress;
}

Result<void> CheckJobLimits(const internal::WorkerJob& job, int result, double seconds) {
  if (seconds > job.seconds()) {
    return Fail(ErrorCode::kOverBudget, "the job did not end within the " +
                                            std::to_string(job.seconds()) +
                                            " seconds that one may take");
  }
  struct stat status {};
  if (fstat(result, &status) == 0 &&
      static_cast<std::uint64_t>(status.st_size) > job.result_bytes()) {
    return Fail(ErrorCode::kOverBudget, "the result exceeds the " +
                                            std::to_string(job.result_bytes()) +
                                            " bytes that one may have");
  }
  return {};
}

}  // namespace strata::server
