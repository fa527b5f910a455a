// What a command gives its job: scratch space, and a part of its memory for the vertices.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "core/run_context.h"
#include "core/scratch.h"
#include "io/open_mesh.h"

namespace strata::server {

/// Scratch space in `directory`, or in the system's directory for temporary files. That may be
/// missing, or on a read-only mount: then null, and the job has to fit memory. Errors: kNotFound,
/// kIo, of a directory that was named.
Result<std::unique_ptr<ScratchFolder>> OpenScratch(const std::optional<std::string>& directory);

/// How to open a mesh for a job: its vertices take at most a third of the context's budget.
io::OpenOptions OpenWithin(RunContext& context);

}  // namespace strata::server
