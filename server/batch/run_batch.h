// `strata batch`.
#pragma once

#include "core/result.h"
#include "core/run_context.h"
#include "server/batch/batch_config.h"
#include "server/batch/batch_progress.h"

namespace strata::server {

/// The exit status of a batch that came to its end with models that failed.
inline constexpr int kSomeFailedStatus = 1;

/// Samples what is to be sampled; the context's cancel flag ends it within a moment, with all that
/// was finished kept. Says how far it is on standard error, unless quiet. Returns what it came to:
/// models that failed are no error here. Errors: those of the places and the options, before
/// anything is sampled; kConflict when another batch is at work there; kIo when the manifest cannot
/// be written; kCancelled.
Result<BatchTally> RunBatch(const BatchCommand& command, RunContext& context);

}  // namespace strata::server
