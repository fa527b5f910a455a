// Small convex polygons: what is left of a triangle inside a cell.
#pragma once

#include <array>

#include "core/vec3.h"

namespace strata {

/// A convex polygon, no allocation. A triangle cut by six planes has at most 9 corners; the rest is
/// room for corners that rounding may add to slivers.
struct Polygon {
  std::array<Vec3, 16> corner;
  int size = 0;

  Polygon() {}  // Leaves the corners as they are: only `size` of them count.
  Polygon(const Polygon& other) { *this = other; }
  Polygon& operator=(const Polygon& other) {
    size = other.size;
    for (int i = 0; i < size; ++i) (*this)[i] = other[i];
    return *this;
  }

  void Push(Vec3 p) {
    if (size < 16) corner[static_cast<std::size_t>(size++)] = p;
  }
  const Vec3& operator[](int i) const { return corner[static_cast<std::size_t>(i)]; }
  Vec3& operator[](int i) { return corner[static_cast<std::size_t>(i)]; }
};

/// The lowest and highest coordinate on `axis`. Precondition: size > 0.
struct Extent {
  double min, max;
};
inline Extent ExtentOf(const Polygon& p, int axis) {
  Extent e{p[0][axis], p[0][axis]};
  for (int i = 1; i < p.size; ++i) {
    const double v = p[i][axis];
    if (v < e.min) e.min = v;
    if (v > e.max) e.max = v;
  }
  return e;
}

/// Where the segment a–b meets the plane `axis = plane`: that coordinate is exact, and the others
/// stay between those of a and b, so that cutting never enlarges a bounding box.
inline Vec3 CutSegment(Vec3 a, Vec3 b, int axis, double plane) {
  const double t = (plane - a[axis]) / (b[axis] - a[axis]);
  Vec3 p;
  for (int k = 0; k < 3; ++k) {
    const double lo = a[k] < b[k] ? a[k] : b[k], hi = a[k] < b[k] ? b[k] : a[k];
    const double v = a[k] + t * (b[k] - a[k]);
    p[k] = v < lo ? lo : v > hi ? hi : v;
  }
  p[axis] = plane;
  return p;
}

/// Cuts `in` by the plane `axis = plane` into what lies below and above; corners on the plane
/// belong to both. Sutherland and Hodgman's rule, both sides in one go.
inline void CutPolygon(const Polygon& in, int axis, double plane, Polygon& below, Polygon& above) {
  below.size = above.size = 0;
  double side = in[in.size - 1][axis] - plane;
  for (int i = 0, previous = in.size - 1; i < in.size; previous = i++) {
    const double next = in[i][axis] - plane;
    if ((side < 0 && next > 0) || (side > 0 && next < 0)) {
      const Vec3 cut = side < 0 ? CutSegment(in[previous], in[i], axis, plane)
                                : CutSegment(in[i], in[previous], axis, plane);
      below.Push(cut);
      above.Push(cut);
    }
    if (next <= 0) below.Push(in[i]);
    if (next >= 0) above.Push(in[i]);
    side = next;
  }
}

/// Area of a polygon with unit normal `normal`.
inline double AreaOf(const Polygon& p, Vec3 normal) {
  Vec3 sum;
  for (int i = 1; i + 1 < p.size; ++i) sum = sum + Cross(p[i] - p[0], p[i + 1] - p[0]);
  return 0.5 * std::fabs(Dot(sum, normal));
}

}  // namespace strata
