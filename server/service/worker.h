// The child's side of an isolated job.
#pragma once

namespace strata::server {

/// The child's descriptors for the mesh (read) and the result (written) of a job that names no
/// paths; jobs and events come and go over its standard input and output, strata.internal.WorkerJob
/// and WorkerEvent.
inline constexpr int kWorkerMesh = 3, kWorkerResult = 4;

/// Runs the jobs that standard input holds, one after the other, and reports each. Closes every
/// other descriptor first, and sets its limits anew for each job: memory (as far as it is its own:
/// RLIMIT_DATA), processor time, no core file. Returns the exit status: 0 when every outcome, good
/// or bad, was reported.
int RunWorker();

}  // namespace strata::server
