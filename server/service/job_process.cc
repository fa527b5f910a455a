#include "server/service/job_process.h"

#include <sys/wait.h>

#include <chrono>
#include <string>

#include "server/service/worker_process.h"

namespace strata::server {
namespace {

using SteadyClock = std::chrono::steady_clock;
constexpr int kTickMs = 50;

Result<v1::SampleSummary> Finish(const internal::WorkerEvent& last) {
  if (last.has_done()) return last.done();
  return tl::unexpected<Error>(ErrorOf(last.failed()));
}

}  // namespace

Error ErrorOf(const internal::WorkerFailure& failure) {
  const auto code = failure.code();
  return {code < kErrorCodeCount ? static_cast<ErrorCode>(code) : ErrorCode::kInternal,
          failure.message()};
}

Error ErrorOfEnd(const internal::WorkerJob& job, int status) {
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU) {
    return {ErrorCode::kOverBudget, "the job used up its processor time"};
  }
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
    return {ErrorCode::kOverBudget,
            "the system ended the job, most likely because memory was short; it may use " +
                std::to_string(job.memory_bytes()) + " bytes"};
  }
  const std::string how = WIFSIGNALED(status)
                              ? "signal " + std::to_string(WTERMSIG(status))
                              : "exit status " + std::to_string(WEXITSTATUS(status));
  return {ErrorCode::kInternal, "the process that sampled " + job.input_name() + " ended with " +
                                    how + "; no other job is touched"};
}

Result<v1::SampleSummary> RunJobIsolated(const internal::WorkerJob& job, int mesh, int result,
                                         const JobWatch& watch) {
  const auto start = SteadyClock::now();
  WorkerProcess child;
  if (auto started = child.Start(mesh, result); !started) return Forward(started);
  child.Send(job);
  child.EndJobs();
  while (!child.ended()) {
    if (const auto event = child.Next(kTickMs)) {
      if (!event->has_progress()) {
        if (auto kept = CheckJobLimits(job, result, 0); !kept) return Forward(kept);
        return Finish(*event);
      }
      if (watch.progress) watch.progress(event->progress());
    }
    const double seconds = std::chrono::duration<double>(SteadyClock::now() - start).count();
    if (auto kept = CheckJobLimits(job, result, seconds); !kept) return Forward(kept);
    if (watch.gone && watch.gone()) return Cancelled();
  }
  return tl::unexpected<Error>(ErrorOfEnd(job, child.Wait()));
}

}  // namespace strata::server
