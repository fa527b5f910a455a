// The paper's own integration, as its authors' program does it: a cross-check, and for people who
// want the published numbers. docs/adr/0002 states how far from the law it is.
#pragma once

#include <cstdint>

#include "core/cell_race.h"
#include "core/run_context.h"

namespace strata {

/// Registers `triangle` in every cell that its bounding box touches; there, splits it into four at
/// the edges' midpoints until a part's area is at most 1/25 of the squared half edge of the cell,
/// dropping parts that do not overlap the cell (a triangle that small at once is not tested); races
/// the parts with priority area * f(centroid); a part that wins gives a uniform point of its own,
/// which may lie outside the cell. Returns the number of cells that got a part. Stops early when
/// the context is cancelled or the sink over
/// its limit.
std::uint64_t SubdivideTriangle(const RaceTriangle& triangle, ReservoirSink& sink,
                                const RunContext& context);

}  // namespace strata
