// Models and outputs in folders of this machine.
#pragma once

#include <memory>
#include <string>

#include "server/batch/places.h"

namespace strata::server {

/// The models below a folder. Hidden files and folders are passed over, and so is the folder
/// `outputs`, should it lie inside. A symbolic link to a file is followed if that lies below the
/// folder, too, else it is a model that fails; one to a folder is not, so that no loop can be.
/// Errors: kNotFound, kInvalidArgument (no folder, or `outputs` is the folder itself or holds it).
Result<std::unique_ptr<ModelSource>> OpenFolderSource(const std::string& folder,
                                                      const std::string& outputs);

/// Outputs below a folder, which is made when its state is opened.
std::unique_ptr<OutputPlace> OpenFolderOutput(const std::string& folder);

}  // namespace strata::server
