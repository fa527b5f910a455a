// Names for triangles that do not depend on the file: a hash of the corner coordinates.
//
// The race is keyed by it, so that the order of triangles, the rotation of corners and the file
// format cannot matter. core/scan_kernel.cc holds a vector twin of every function here; a test
// compares them bit by bit.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include "core/vec3.h"

namespace strata {

/// Odd constants of the hashes below (fractional bits of square roots of primes).
inline constexpr std::array<std::uint64_t, 5> kHashMultipliers = {
    0x6a09e667f3bcc909ULL, 0xbb67ae8584caa73bULL, 0x3c6ef372fe94f82bULL, 0xa54ff53a5f1d36f1ULL,
    0x510e527fade682d1ULL};

/// Hash of a point. -0 and +0 are the same number and hash alike.
inline std::uint64_t HashVertex(Vec3 p) {
  const auto x = std::bit_cast<std::uint64_t>(p.x + 0.0);
  const auto y = std::bit_cast<std::uint64_t>(p.y + 0.0);
  const auto z = std::bit_cast<std::uint64_t>(p.z + 0.0);
  std::uint64_t h = x * kHashMultipliers[0];
  h ^= h >> 32;
  h = (h + y) * kHashMultipliers[1];
  h ^= h >> 29;
  h = (h + z) * kHashMultipliers[2];
  return h ^ (h >> 32);
}

/// Hash of the directed edge between two hashed corners.
inline std::uint64_t HashEdge(std::uint64_t from, std::uint64_t to) {
  const std::uint64_t e = (from ^ std::rotl(to, 25)) * kHashMultipliers[3];
  return e ^ (e >> 31);
}

/// Hash of an oriented triangle from its corners' hashes, the same for its three rotations.
inline std::uint64_t HashTriangle(std::uint64_t a, std::uint64_t b, std::uint64_t c) {
  const std::uint64_t s = (HashEdge(a, b) + HashEdge(b, c) + HashEdge(c, a)) * kHashMultipliers[4];
  return s ^ (s >> 32);
}

/// Which corner comes first in the canonical rotation: the one with the smallest hash (as a signed
/// number, which vector units compare fastest).
inline int CanonicalFirst(std::uint64_t a, std::uint64_t b, std::uint64_t c) {
  const auto i = static_cast<std::int64_t>(a), j = static_cast<std::int64_t>(b),
             k = static_cast<std::int64_t>(c);
  if (j < i && !(k < j)) return 1;
  if (k < i && k < j) return 2;
  return 0;
}

/// Twice the area times the unit normal, from the canonical rotation: the same bits for the three
/// rotations of a triangle. A triangle is part of the surface if this is neither zero nor too large
/// for a double.
inline Vec3 CanonicalAreaVector(Vec3 a, Vec3 b, Vec3 c) {
  switch (CanonicalFirst(HashVertex(a), HashVertex(b), HashVertex(c))) {
    case 1:
      return Cross(c - b, a - b);
    case 2:
      return Cross(a - c, b - c);
    default:
      return Cross(b - a, c - a);
  }
}

/// Whether a triangle has an area that can be sampled.
inline bool IsUsable(Vec3 area_vector) {
  const double n2 = Norm2(area_vector);
  return n2 > 0 && n2 < HUGE_VAL;
}

/// The surface hash: an order-independent sum of the triangles' hashes, 128 bits. Two files that
/// hold the same triangles, in whatever order, rotation or format, have the same one. Not
/// cryptographic.
struct SurfaceHash {
  std::uint64_t low = 0, high = 0;
  void Add(std::uint64_t triangle_hash) {
    low += triangle_hash;
    high += Spread(triangle_hash);
  }
  void Add(const SurfaceHash& other) {
    low += other.low;
    high += other.high;
  }
  static std::uint64_t Spread(std::uint64_t h) {
    h *= kHashMultipliers[0];
    return h ^ (h >> 31);
  }
  friend bool operator==(const SurfaceHash&, const SurfaceHash&) = default;
};

}  // namespace strata
