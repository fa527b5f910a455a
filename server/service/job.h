// One sampling job as the service runs it: from an open mesh file to an open result file.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "core/result.h"
#include "core/run_context.h"
#include "io/companion_file.h"
#include "strata/internal/worker.pb.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// What a job has of whoever waits for it. Both functions are called on the waiting thread, about
/// 20 times a second; either may be empty.
struct JobWatch {
  std::function<bool()> gone;  ///< True: nobody wants the result any more.
  std::function<void(const v1::Progress&)> progress;
  /// It was accepted before, and waits however many others do.
  bool accepted = false;
  /// As in internal::WorkerJob; what is left there is the waiter's to remove.
  std::string checkpoint_folder, checkpoint_key;
};

/// Runs `job` on this thread (and its workers) from job.input to job.output; where it names none,
/// from the open file `mesh` to the open, empty file `result`. Both stay open. Memory:
/// job.memory_bytes. Files that the mesh names come from `companions`, without it from the input's
/// folder. Errors: those of RunSample; messages call the mesh job.input_name.
Result<v1::SampleSummary> RunJob(const internal::WorkerJob& job, int mesh, int result,
                                 RunContext& context,
                                 std::shared_ptr<const io::CompanionFiles> companions = nullptr);

/// RunJob on a thread of its own, watched. Errors: also kCancelled when it is gone, kOverBudget
/// when it outgrows job.seconds or job.result_bytes.
Result<v1::SampleSummary> RunJobInProcess(const internal::WorkerJob& job, int mesh, int result,
                                          const JobWatch& watch);

/// Where `context` stands.
v1::Progress ProgressOf(const RunContext& context);

/// kOverBudget, when `result` has more than job.result_bytes or `seconds` are more than
/// job.seconds.
Result<void> CheckJobLimits(const internal::WorkerJob& job, int result, double seconds);

}  // namespace strata::server
