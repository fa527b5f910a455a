// A part of a merge, for one of several processes.
#pragma once

#include <span>

#include "core/gather.h"
#include "core/parcels.h"
#include "core/partial.h"
#include "core/result.h"
#include "core/run_context.h"

namespace strata {

/// The samples in a region's parcels, exactly as merging everything decides them, from partials
/// that are together a whole surface. options.parcel_cells must be set.
///
/// Reads the indexes of all partials, and the reservoirs of the region and of its surroundings: the
/// blocks that its samples may conflict with, and as much more as the components of the conflict
/// graph that reach into the region need (docs/adr/0010). A region may have no parcels; then there
/// are no samples, and no source of them. The partials must outlive the samples. Memory: as
/// GatherInPasses, for what is read; the indexes' buffers while they are read; 12 bytes a block
/// around. Errors: those of GatherInPasses; kCorruptInput for a damaged partial.
Result<Gathered> GatherPartials(std::span<const Partial> parts, const Region& region,
                                const GatherOptions& options, RunContext& context);

}  // namespace strata
