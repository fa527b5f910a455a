// Affine maps of space in double precision.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "core/vec3.h"

namespace strata::io {

/// p -> M p + t. Rows of three factors and one summand: m[4 * row + column]. Plain operations in a
/// fixed order, so that the same numbers come out everywhere.
struct Affine {
  std::array<double, 12> m{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};

  friend bool operator==(const Affine&, const Affine&) = default;
  bool is_identity() const { return *this == Affine{}; }

  Vec3 operator()(Vec3 p) const {
    return {m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3],
            m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
            m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
  }
  /// First `b`, then `a`.
  friend Affine operator*(const Affine& a, const Affine& b) {
    Affine c;
    for (std::size_t row = 0; row < 3; ++row) {
      const double* const r = &a.m[4 * row];
      for (std::size_t column = 0; column < 4; ++column) {
        const double sum = r[0] * b.m[column] + r[1] * b.m[4 + column] + r[2] * b.m[8 + column];
        c.m[4 * row + column] = column == 3 ? sum + r[3] : sum;
      }
    }
    return c;
  }
  /// Negative where the map turns the surface inside out.
  double Determinant() const {
    return Dot({m[0], m[1], m[2]}, Cross({m[4], m[5], m[6]}, {m[8], m[9], m[10]}));
  }

  /// A normal of what the map moves, of the length it had; 0 where the map leaves none. By the
  /// matrix of cofactors, which is the inverse transpose but for a factor.
  Vec3 TurnNormal(Vec3 from) const {
    if (is_identity()) return from;
    const Vec3 x{m[0], m[4], m[8]}, y{m[1], m[5], m[9]}, z{m[2], m[6], m[10]};
    const Vec3 n = Cross(y, z) * from.x + Cross(z, x) * from.y + Cross(x, y) * from.z;
    const double length = Norm(n), before = Norm(from);
    return n * (length > 0 ? (Determinant() < 0 ? -1 : 1) * before / length : 0);
  }

  /// From the unit quaternion (x, y, z, w), which is normalised first; precondition: not 0.
  static Affine FromTrs(Vec3 translation, std::array<double, 4> rotation, Vec3 scale) {
    auto [x, y, z, w] = rotation;
    const double norm = std::sqrt(x * x + y * y + z * z + w * w);
    x /= norm, y /= norm, z /= norm, w /= norm;
    Affine a;
    a.m = {(1 - 2 * (y * y + z * z)) * scale.x, 2 * (x * y - z * w) * scale.y,
           2 * (x * z + y * w) * scale.z,       translation.x,
           2 * (x * y + z * w) * scale.x,       (1 - 2 * (x * x + z * z)) * scale.y,
           2 * (y * z - x * w) * scale.z,       translation.y,
           2 * (x * z - y * w) * scale.x,       2 * (y * z + x * w) * scale.y,
           (1 - 2 * (x * x + y * y)) * scale.z, translation.z};
    return a;
  }
};

}  // namespace strata::io
