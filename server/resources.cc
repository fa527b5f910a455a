#include "server/resources.h"

namespace strata::server {

Result<std::unique_ptr<ScratchFolder>> OpenScratch(const std::optional<std::string>& directory) {
  auto folder = directory ? ScratchFolder::Open(*directory) : ScratchFolder::OpenSystems();
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
