#include "core/parcels.h"

#include <algorithm>
#include <cmath>

#include "core/territory.h"

namespace strata {
namespace {

constexpr int kBlockLevel = 3;

}  // namespace

std::uint64_t CellsPerParcel(std::uint64_t tile_samples, double min_distance) {
  double kept = 1;
  if (min_distance > 0) kept = std::clamp(1.6 - 1.75 * min_distance, 1.0 / 16, 0.75);
  return std::max<std::uint64_t>(
      static_cast<std::uint64_t>(std::floor(static_cast<double>(tile_samples) / kept)), 1);
}

Result<std::vector<OctreeNode>> PlanParcels(std::uint64_t most_cells, const Bounds& bounds,
                                            double edge, const VisitBlocks& visit) {
  OctreePlan plan({.most = most_cells, .finest_level = kBlockLevel},
                  OctreePlan::StartLevel(bounds, edge));
  do {
    auto visited =
        visit([&](Cell block, std::uint64_t cells) { plan.Add(CodeOfBlock(block), cells); });
    if (!visited) return Forward(visited);
    plan.Settle();
  } while (plan.unsettled());
  return plan.nodes();
}

std::span<const OctreeNode> ParcelsOf(const Region& region, std::span<const OctreeNode> parcels) {
  __extension__ typedef unsigned __int128 Wide;
  Wide total = 0;
  for (const OctreeNode& parcel : parcels) total += parcel.count;
  std::size_t begin = parcels.size(), end = 0;
  Wide before = 0;
  for (std::size_t p = 0; p < parcels.size(); ++p) {
    // By where its middle lies among all cells.
    const Wide middle = 2 * before + parcels[p].count;
    before += parcels[p].count;
    if (middle * region.count / (2 * total) != region.index) continue;
    begin = std::min(begin, p);
    end = p + 1;
  }
  return begin < end ? parcels.subspan(begin, end - begin) : parcels.subspan(0, 0);
}

}  // namespace strata
