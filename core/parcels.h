// Parcels: the octree nodes that several processes share a surface's cells by.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "core/cell_octree.h"
#include "core/result.h"

namespace strata {

/// How many occupied cells a parcel may hold so that it leaves about `tile_samples` samples or
/// less, or a few times as many: a function of both alone. >= 1.
///
/// Tiles lie within parcels. A parcel that leaves more samples than a tile holds is divided by its
/// samples, as one octree over everything would be; one that leaves few is a small tile. So the
/// share of cells that keep their sample is taken low, 1.6 - 1.75 m within 1/16 and 3/4; measured
/// were 0.77 for m = 0.5, 0.28 to 0.32 for 0.75, 0.08 to 0.11 for 0.9, 0.05 for 1.
std::uint64_t CellsPerParcel(std::uint64_t tile_samples, double min_distance);

/// Calls back for every block with its number of occupied cells.
using VisitBlocks =
    std::function<Result<void>(const std::function<void(Cell block, std::uint64_t cells)>&)>;

/// Divides the occupied cells into parcels of at most `most_cells`, but no smaller than a block:
/// the fewest octree nodes, ascending, each with its cells as the count. A function of the cells
/// and the limit alone. `bounds` and `edge`, of the surface, only save visits, of which there is
/// at least one. Errors: those of the visits.
Result<std::vector<OctreeNode>> PlanParcels(std::uint64_t most_cells, const Bounds& bounds,
                                            double edge, const VisitBlocks& visit);

/// One of `count` processes that share a merge. index < count.
struct Region {
  std::uint32_t index = 0, count = 1;
};

/// The parcels of a region: neighbours in their order, with about one `count`-th of the cells, or
/// none. Every parcel is in exactly one region.
std::span<const OctreeNode> ParcelsOf(const Region& region, std::span<const OctreeNode> parcels);

}  // namespace strata
