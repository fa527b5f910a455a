// `strata info`: what a mesh file holds.
#pragma once

#include "core/result.h"
#include "core/run_context.h"
#include "server/command_line.h"

namespace strata::server {

/// Reads the mesh once, serially, and prints what it holds to standard output. An empty surface is
/// no error. Errors: those of OpenMesh and SummarizeMesh; kIo when standard output fails.
Result<void> RunInfo(const InfoCommand& command, RunContext& context);

}  // namespace strata::server
