// The paper's rejection, one sample at a time.
#pragma once

#include <cstdint>
#include <vector>

#include "core/rejection.h"

namespace strata::test {

/// "The candidates for removal are all points with a non-empty N(p) = {q | d(p,q) < m}. Choose the
/// candidate r for which the centroid of N(r) is furthest from r. After removing r, update the
/// neighborhoods of all points in N(r) and repeat while candidates remain." Ties as the design
/// says: the later race key goes, then the larger cell, then the later in the list. Distances are
/// compared squared and centroids summed in ascending order, since configurations with exact ties
/// are common and other formulas would round them differently. O(n^3).
inline std::vector<std::uint8_t> RejectOneAtATime(const RejectionInput& in, double distance) {
  const std::size_t n = in.position.size();
  std::vector<std::uint8_t> alive(n, 1);
  for (;;) {
    std::size_t worst = n;
    double worst_score = -1;
    const auto goes_before = [&](std::size_t i, double score) {
      if (worst == n || score != worst_score) return worst == n || score > worst_score;
      if (in.time[i] != in.time[worst]) return in.time[i] > in.time[worst];
      if (in.cell[i] != in.cell[worst]) return in.cell[i] > in.cell[worst];
      return i > worst;
    };
    for (std::size_t i = 0; i < n; ++i) {
      if (!alive[i]) continue;
      double x = 0, y = 0, z = 0, count = 0;
      const Vec3 p = in.position[i];
      for (std::size_t j = 0; j < n; ++j) {
        if (j == i || !alive[j]) continue;
        const Vec3 q = in.position[j];
        const double dx = q.x - p.x, dy = q.y - p.y, dz = q.z - p.z;
        if (!(dx * dx + dy * dy + dz * dz < distance * distance)) continue;
        x += q.x, y += q.y, z += q.z, count += 1;
      }
      if (count == 0) continue;
      const double cx = x / count - p.x, cy = y / count - p.y, cz = z / count - p.z;
      const double score = cx * cx + cy * cy + cz * cz;
      if (goes_before(i, score)) worst = i, worst_score = score;
    }
    if (worst == n) return alive;
    alive[worst] = 0;
  }
}

}  // namespace strata::test
