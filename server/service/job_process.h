// A job in a child process of its own, so that a crash or an outsized allocation ends one job.
#pragma once

#include "core/result.h"
#include "server/service/job.h"

namespace strata::server {

/// What a child said of a job that failed.
Error ErrorOf(const internal::WorkerFailure& failure);
/// Why a child ended, by its status of waitpid, before it had said anything of its job.
Error ErrorOfEnd(const internal::WorkerJob& job, int status);

/// As RunJobInProcess, in a child. The child inherits the two files and nothing else; it dies with
/// the calling thread. Blocks until it has ended, whatever happens.
/// Errors: as RunJobInProcess; kOverBudget when the child ran into a limit of the system's;
/// kInternal when it crashed (the message names the signal); kIo when it cannot be started.
Result<v1::SampleSummary> RunJobIsolated(const internal::WorkerJob& job, int mesh, int result,
                                         const JobWatch& watch);

}  // namespace strata::server
