#include "core/lattice.h"

#include <algorithm>
#include <cmath>

namespace strata {

Lattice LatticeFor(const Bounds& bounds, Resolution resolution) {
  const Vec3 side = bounds.max - bounds.min;
  const double longest = std::max({side.x, side.y, side.z});
  Lattice lattice;
  lattice.edge = longest / (resolution.n - 0.5);
  for (int a = 0; a < 3; ++a) {
    const double width = side[a] / lattice.edge;
    double cells = std::ceil(width);
    // The longest side has a quarter of a cell at each end by construction; leave room for
    // rounding.
    if (cells - width < 0.5 - 1e-6) cells += 1;
    const double center = bounds.min[a] + 0.5 * side[a];
    lattice.origin[a] = center - 0.5 * cells * lattice.edge;
  }
  return lattice;
}

Lattice LatticeFor(VoxelSize voxel_size) { return {{0, 0, 0}, voxel_size.edge}; }

Lattice LatticeFor(Vec3 ball_center, double ball_radius, Height height) {
  return {ball_center - Vec3{ball_radius, ball_radius, ball_radius},
          std::ldexp(2 * ball_radius, 1 - static_cast<int>(height.h))};
}

}  // namespace strata
