#include "server/resources.h"

#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <system_error>

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
  const auto [file, member] = io::SplitMember(command.input);
  const auto digest = io::FileDigest(file);
  if (!digest) return Forward(digest);
  struct stat status {};
  if (stat(file.c_str(), &status) != 0) {
    return Fail(ErrorCode::kNotFound, command.input + ": vanished while it was opened");
  }
  const SampleOptions& options = command.options;
  const Json job = {kVersion,
                    geteuid(),
                    *digest,
                    member,
                    status.st_mtim.tv_sec,
                    status.st_mtim.tv_nsec,
                    LatticeToJson(options.lattice, lattice.value_or(Lattice{})),
                    lattice.has_value(),
                    options.lambda,
                    options.seed,
                    options.integrator,
                    options.method,
                    options.count,
                    (options.attributes & kBarycentric) != 0 || !options.mesh_attributes.empty() ||
                        options.vertex_normals,
                    share.index,
                    share.count};
  return io::Sha256Hex(job.dump()).substr(0, 32);
}

namespace {

// Beside this program where both were built, else where it is installed.
std::string HelperProgram(const char* name) {
  std::error_code failed;
  const auto folder = std::filesystem::read_symlink("/proc/self/exe", failed).parent_path();
  const auto beside = folder / name;
  if (std::filesystem::exists(beside, failed)) return beside.string();
  return (folder.parent_path() / "libexec/strata" / name).string();
}

}  // namespace

std::string VdbProgram() { return HelperProgram("strata-vdb"); }

io::OpenOptions OpenWithin(RunContext& context, bool assimp) {
  io::OpenOptions open;
  open.memory = &context.memory();
  open.vertex_budget = context.memory().budget() / 3;
  open.scratch = context.scratch();
  open.context = &context;
  if (assimp) {
    open.assimp = HelperProgram("strata-assimp");
  }
  return open;
}

}  // namespace strata::server
