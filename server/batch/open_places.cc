#include "server/batch/open_places.h"

#include <utility>

#include "server/batch/folder_places.h"

namespace strata::server {

Result<Places> OpenPlaces(const BatchCommand& command) {
  auto models = OpenFolderSource(command.repository, command.output);
  if (!models) return Forward(models);
  return Places{*std::move(models), OpenFolderOutput(command.output)};
}

}  // namespace strata::server
