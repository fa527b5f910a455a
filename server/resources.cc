#include "server/resources.h"

#include <sys/stat.h>
#include <unistd.h>

#include "core/version.h"
#include "io/file_digest.h"
#include "io/sha256.h"
#include "server/json_parts.h"

namespace strata::server {

Result<std::unique_ptr<ScratchFolder>> OpenScratch(const std::optional<std::string>& directory) {
  auto folder = directory ? ScratchFolder::Open(*directory) : ScratchFolder::OpenSystems();
  if (!folder && !directory) return std::unique_ptr<ScratchFolder>();
  return folder;
}

Result<std::string> JobKey(const SampleCommand& command, const Share& share,
                           const std::optional<Lattice>& lattice) {
  const auto digest = io::FileDigest(command.input);
  if (!digest) return Forward(digest);
  struct stat status {};
  if (stat(command.input.c_str(), &status) != 0) {
    return Fail(ErrorCode::kNotFound, command.input + ": vanished while it was opened");
  }
  const SampleOptions& options = command.options;
  const Json job = {kVersion,
                    geteuid(),
                    *digest,
                    status.st_mtim.tv_sec,
                    status.st_mtim.tv_nsec,
                    LatticeToJson(options.lattice, lattice.value_or(Lattice{})),
                    lattice.has_value(),
                    options.lambda,
                    options.seed,
                    options.integrator,
                    options.method,
                    options.count,
                    options.attributes & kBarycentric,
                    share.index,
                    share.count};
  return io::Sha256Hex(job.dump()).substr(0, 32);
}

io::OpenOptions OpenWithin(RunContext& context) {
  io::OpenOptions open;
  open.memory = &context.memory();
  open.vertex_budget = context.memory().budget() / 3;
  open.scratch = context.scratch();
  open.context = &context;
  return open;
}

}  // namespace strata::server
