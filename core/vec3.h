// Three doubles, and the few operations the method needs. Plain IEEE operations in a fixed order:
// compiled with -ffp-contract=off they give the same bits on every processor and compiler.
#pragma once

#include <cmath>
#include <cstdint>

namespace strata {

/// A point or direction. World units or cells, as the name of the variable says.
struct Vec3 {
  double x = 0, y = 0, z = 0;

  double operator[](int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
  double& operator[](int axis) { return axis == 0 ? x : axis == 1 ? y : z; }
  friend Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend Vec3 operator*(Vec3 a, double s) { return {a.x * s, a.y * s, a.z * s}; }
  friend bool operator==(const Vec3&, const Vec3&) = default;
};

inline double Dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 Cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double Norm2(Vec3 a) { return Dot(a, a); }
inline double Norm(Vec3 a) { return std::sqrt(Norm2(a)); }

/// Single-precision triple: normals.
struct Vec3f {
  float x = 0, y = 0, z = 0;
  friend bool operator==(const Vec3f&, const Vec3f&) = default;
};

/// A cell of the lattice: the half-open cube [x,x+1) × [y,y+1) × [z,z+1) in units of the edge.
struct Cell {
  std::int32_t x = 0, y = 0, z = 0;
  friend bool operator==(const Cell&, const Cell&) = default;
  friend auto operator<=>(const Cell&, const Cell&) = default;  ///< Lexicographic.
};

/// An axis-aligned box, empty until something is added.
struct Bounds {
  Vec3 min{HUGE_VAL, HUGE_VAL, HUGE_VAL};
  Vec3 max{-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};

  bool empty() const { return !(min.x <= max.x); }
  void Add(Vec3 p) {
    min = {p.x < min.x ? p.x : min.x, p.y < min.y ? p.y : min.y, p.z < min.z ? p.z : min.z};
    max = {p.x > max.x ? p.x : max.x, p.y > max.y ? p.y : max.y, p.z > max.z ? p.z : max.z};
  }
  friend bool operator==(const Bounds&, const Bounds&) = default;
};

}  // namespace strata
