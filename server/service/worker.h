// The child's side of an isolated job.
#pragma once

namespace strata::server {

/// The child's descriptors for the mesh (read) and the result (written); job and events are its
/// standard input and output, strata.internal.WorkerJob and WorkerEvent.
inline constexpr int kWorkerMesh = 3, kWorkerResult = 4;

/// Runs the one job that standard input holds and reports it. Closes every other descriptor first,
/// and sets its limits: memory (as far as it is its own: RLIMIT_DATA),
/// processor time, no core file. Returns the exit status: 0 when the outcome, good or bad, was
/// reported.
int RunWorker();

}  // namespace strata::server
