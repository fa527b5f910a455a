// The minimum distance: the paper's rule, section 2, exact and in parallel.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/reservoir.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/vec3.h"

namespace strata {

/// Points to be thinned. Spans of equal length; positions finite.
struct RejectionInput {
  std::span<const Vec3> position;  ///< World units.
  std::span<const double> time;    ///< Race keys: of two tied candidates the later one goes,
  std::span<const Cell> cell;      ///< then the one with the larger cell.
  /// Empty, or what each point stands for: a point that is removed leaves all it has to the nearest
  /// of the neighbours it still had (of equally near ones to the one that would go last), and keeps
  /// 0. Sums are exact, so the areas do not depend on threads.
  std::span<FixedArea> area = {};
};

/// What RejectClosePoints says of a point.
inline constexpr std::uint8_t kRemovedSample = 0, kSurvivingSample = 1, kOpenSample = 2;

/// Decides which points survive: while any two are closer than `distance`, remove the candidate
/// whose neighbours' centroid is furthest from it; update; repeat. Returns one byte per point:
/// kRemovedSample or kSurvivingSample. Works on any point set, whatever the lattice.
///
/// Equal to doing that one at a time over the whole set: points farther than `distance` apart do
/// not see each other, so connected components of the conflict graph are independent, and they run
/// in parallel. Cost: O(n) expected to find conflicts, O(c log c) per component of c conflicts.
/// `open`, if not empty, holds a byte per point: nonzero = points that are not in the set may be
/// too close to it. Components with such a point are left alone: kOpenSample.
/// Memory: about 24 bytes per point and 60 per conflict. Errors: kCancelled.
Result<std::vector<std::uint8_t>> RejectClosePoints(const RejectionInput& input, double distance,
                                                    const RunContext& context,
                                                    std::span<const std::uint8_t> open = {});

}  // namespace strata
