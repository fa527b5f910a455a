// The lattice of cells: where it lies, how fine it is.
#pragma once

#include <cstdint>
#include <variant>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata {

/// An infinite grid of cubic cells. Cell (i,j,k) is the half-open cube
/// origin + edge * [i,i+1) × [j,j+1) × [k,k+1).
struct Lattice {
  Vec3 origin;      ///< World units.
  double edge = 1;  ///< World units, > 0.
};

/// `n` cells along the longest side of the surface's bounding box. 1 <= n <= kMaxResolution.
struct Resolution {
  std::uint32_t n = 128;
};
/// Cells of edge `edge` world units, with a cell's corner at the world's origin, so that
/// neighbouring models share the lattice. kMinEdge <= edge <= kMaxEdge.
struct VoxelSize {
  double edge = 1;
};
/// The paper's octree of height h: edge 2R/2^(h-1), anchored to the cube around the surface's
/// minimum enclosing ball of radius R. 1 <= h <= kMaxHeight.
struct Height {
  std::uint32_t h = 7;
};
using LatticeSpec = std::variant<Resolution, VoxelSize, Height>;

/// The lattice for a surface within `bounds` (not empty, some side > 0). The box lies centred in it
/// with at least a quarter of a cell between each of its faces and the next lattice plane, so that
/// no face of an axis-aligned box is flush with the lattice, where rounding would put its points
/// now into one layer of cells and now into the other. Hence edge = longest side / (n - 1/2).
Lattice LatticeFor(const Bounds& bounds, Resolution resolution);

/// The lattice of the world: origin 0.
Lattice LatticeFor(VoxelSize voxel_size);

/// The paper's lattice: edge 2R/2^(h-1), with a corner of the cube around the ball as origin.
Lattice LatticeFor(Vec3 ball_center, double ball_radius, Height height);

}  // namespace strata
