// What one occupied cell keeps, and how two of them become one.
#pragma once

#include <cstdint>
#include <limits>

#include "core/vec3.h"

namespace strata {

/// Surface area inside a cell, in units of 2^-44 edge². Fixed point, because sums of floats depend
/// on their order. Saturates (instead of wrapping) at 2^20 faces of a cell.
using FixedArea = std::uint64_t;
inline constexpr double kFixedAreaUnit = 0x1p-44;

inline FixedArea AddAreas(FixedArea a, FixedArea b) {
  const FixedArea sum = a + b;
  return sum < a ? std::numeric_limits<FixedArea>::max() : sum;
}

/// Rounds to nearest. Precondition: 0 <= area < 2^8 (one piece covers less than two faces).
inline FixedArea ToFixedArea(double area) {
  // Adding 2^52 leaves the rounded integer in the mantissa; the vector code does the same.
  return static_cast<FixedArea>((area * 0x1p44 + 0x1p52) - 0x1p52);
}

/// The best sample of a cell so far, and the cell's total. Merging is associative and commutative;
/// of the sample (not the area) it is idempotent as well.
struct Reservoir {
  double time = std::numeric_limits<double>::infinity();  ///< Arrival; infinity = no sample yet.
  std::uint64_t hash = 0;                                 ///< Of the sample's triangle.
  std::uint64_t triangle = 0;                             ///< Its id in file order.
  Vec3 local;                      ///< Sample relative to the cell's centre, in edges.
  double barycentric[2] = {0, 0};  ///< Weights of the second and third corner in file order.
  Vec3f normal;                    ///< Unit.
  FixedArea area = 0;

  /// Whether this sample beats `other`: earlier arrival; coincident copies of one triangle arrive
  /// at the same time, then the first in the file stands for all.
  bool Beats(const Reservoir& other) const {
    if (time != other.time) return time < other.time;
    if (hash != other.hash) return hash < other.hash;
    return triangle < other.triangle;
  }
  void Merge(const Reservoir& other) {
    const FixedArea sum = AddAreas(area, other.area);
    if (other.Beats(*this)) *this = other;
    area = sum;
  }
};

}  // namespace strata
