// A job in a child process of its own, so that a crash or an outsized allocation ends one job.
#pragma once

#include "core/result.h"
#include "server/service/job.h"

namespace strata::server {

/// The internal command with which the program starts itself again for one job.
inline constexpr const char* kWorkerCommand = "worker";

/// As RunJobInProcess, in a child. The child inherits the two files and nothing else; it dies with
/// the calling thread. Blocks until it has ended, whatever happens.
/// Errors: as RunJobInProcess; kOverBudget when the child ran into a limit of the system's;
/// kInternal when it crashed (the message names the signal); kIo when it cannot be started.
Result<v1::SampleSummary> RunJobIsolated(const internal::WorkerJob& job, int mesh, int result,
                                         const JobWatch& watch);

}  // namespace strata::server
