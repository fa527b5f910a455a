// Which kind of place a batch's REPO and OUT name.
#pragma once

#include <memory>

#include "core/result.h"
#include "server/batch/batch_config.h"
#include "server/batch/places.h"

namespace strata::server {

/// Where a batch's models come from and its outputs go.
struct Places {
  std::unique_ptr<ModelSource> models;
  std::unique_ptr<OutputPlace> outputs;
};

/// Errors: those of the places.
Result<Places> OpenPlaces(const BatchCommand& command);

}  // namespace strata::server
