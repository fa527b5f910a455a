// What a batch has to do: which models, with which options, and which of them are done already.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/batch/batch_config.h"
#include "server/batch/batch_progress.h"
#include "server/batch/former_lines.h"
#include "server/batch/manifest.h"
#include "server/batch/places.h"
#include "server/batch/schedule.h"

namespace strata::server {

/// The work of a batch. The tasks point into models and finder.
struct BatchPlan {
  std::vector<ModelEntry> models;  ///< In order of the paths' bytes: of this share.
  std::unique_ptr<ModelOptionsFinder> options;
  std::vector<BatchTask> tasks;
  BatchTally tally;  ///< Of the models that need no task.
  double cost = 0;   ///< Of all tasks.
};

/// Where a plan looks.
struct PlanPlaces {
  ModelSource& source;
  OutputPlace& outputs;
  Manifest& manifest;  ///< That this batch writes.
  const FormerLines& former;
};

/// Lists the models and looks each up in what former batches left; lines of other shares that still
/// hold are copied into the manifest. Errors: those of the places and of the options.
Result<BatchPlan> PlanBatch(const BatchCommand& command, const PlanPlaces& places);

/// Whether a path belongs to a share. The same on every machine.
bool InShare(const std::string& path, const ModelShare& share);

/// How long a model may take on one processor, roughly; seconds. `path` tells whether it is packed.
double CostOf(const ModelEntry& model, const v1::SampleOptions& options);

}  // namespace strata::server
