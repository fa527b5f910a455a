// From samples to an output: what the commands that write samples have in common.
#pragma once

#include <cstdint>
#include <functional>

#include "core/result.h"
#include "core/run_context.h"
#include "core/sample_mesh.h"
#include "core/samples.h"
#include "io/sample_writer.h"
#include "server/command_line.h"

namespace strata::server {

/// The command's options, with what its format needs of the samples beside what was asked for.
SampleOptions OptionsForOutput(const SampleCommand& command);

/// The header of the command's output, but for what depends on the samples themselves: their count,
/// bounds and parcels. Of the stats, lattice, surface hash and bounds must be known.
SampleHeader HeaderOf(const SampleCommand& command, const SampleStats& stats);
/// With these as well.
SampleHeader HeaderOf(const SampleCommand& command, const SampledMesh& sampled);

/// The context's memory and scratch space for a writer.
io::WriterResources ResourcesOf(const SampleCommand& command, RunContext& context);

/// Hands all samples to the writer, and to `visit` if that is not null, and finishes. Returns the
/// bytes of the output. Errors: the source's, the writer's, kCancelled.
Result<std::uint64_t> WriteAll(SampledMesh& sampled, SampleWriter& writer, RunContext& context,
                               const std::function<void(const SampleColumns&)>& visit = nullptr);

}  // namespace strata::server
