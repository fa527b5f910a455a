// What a command gives its job: scratch space, and a part of its memory for the vertices.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "core/mesh_reader.h"
#include "core/run_context.h"
#include "core/scratch.h"
#include "io/open_mesh.h"
#include "server/command_line.h"

namespace strata::server {

/// Scratch space in `directory`, or in the system's directory for temporary files. That may be
/// missing, or on a read-only mount: then null, and the job has to fit memory. Errors: kNotFound,
/// kIo, of a directory that was named.
Result<std::unique_ptr<ScratchFolder>> OpenScratch(const std::optional<std::string>& directory);

/// What names a job's folder in scratch space: the same for jobs whose scans come to the same
/// reservoirs. Two files that FileDigest does not tell apart and that were modified at the same
/// nanosecond count as one. Errors: kNotFound, kIo.
Result<std::string> JobKey(const SampleCommand& command, const Share& share,
                           const std::optional<Lattice>& lattice);

/// How to open a mesh for a job: its vertices take at most a third of the context's budget. With
/// `assimp`, what is of another format goes to the program strata-assimp beside this one.
io::OpenOptions OpenWithin(RunContext& context, bool assimp = false);

/// The program strata-vdb beside this one, or where it is installed; it may be missing.
std::string VdbProgram();

}  // namespace strata::server
