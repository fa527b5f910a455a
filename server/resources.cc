#include "server/resources.h"

#include <filesystem>
#include <system_error>

namespace strata::server {

Result<std::unique_ptr<ScratchFolder>> OpenScratch(const std::optional<std::string>& directory) {
  std::error_code failed;
  const auto system = std::filesystem::temp_directory_path(failed);
  auto folder = ScratchFolder::Open(directory.value_or(system.string()));
  if (!folder && !directory) return std::unique_ptr<ScratchFolder>();
  return folder;
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
