// The Poisson process behind uniform samples: on each triangle, at unit rate per area.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>

#include "core/mesh_reader.h"
#include "core/vec3.h"

namespace strata {

/// A point that has arrived.
struct UniformArrival {
  double time;             ///< In units of 1 / area, world units; earlier goes first.
  std::uint64_t hash;      ///< Of its triangle.
  std::uint64_t number;    ///< Among its triangle's.
  std::uint64_t triangle;  ///< Its id in file order.
  Vec3 position;           ///< World units, within its triangle's bounds.
  double barycentric[2];   ///< Weights of the second and third corner in file order.
  Vec3f normal;            ///< Unit.

  /// The order of all arrivals. Coincident copies of one triangle have the same arrivals; of these
  /// the first in the file goes first.
  friend bool operator<(const UniformArrival& a, const UniformArrival& b) {
    if (a.time != b.time) return a.time < b.time;
    if (a.hash != b.hash) return a.hash < b.hash;
    if (a.number != b.number) return a.number < b.number;
    return a.triangle < b.triangle;
  }
  /// Whether it is the same point of the surface.
  bool IsCopyOf(const UniformArrival& other) const {
    return time == other.time && hash == other.hash && number == other.number &&
           position == other.position;
  }
};

/// A triangle of the surface, and when points arrive on it. Pure: an arrival is a function of the
/// seed and the corners' coordinates, whatever their rotation. Any thread.
///
/// Time runs in windows of kWindow expected arrivals, each drawn from numbers of its own: the
/// process has no memory, so that starting anew at a window's begin keeps the law, and any stretch
/// of time can be drawn without what came before.
class TriangleArrivals {
 public:
  static constexpr double kWindow = 16;

  /// Triangle `i` of the batch; nothing if it has no positive, finite area.
  static std::optional<TriangleArrivals> Of(const TriangleBatch& batch, std::size_t i);

  /// World units squared. > 0.
  double area() const { return area_; }
  std::uint64_t hash() const { return hash_; }

  /// One past the last window that reaches into [0, end), and the first that reaches beyond begin.
  std::uint64_t WindowsUntil(double end) const;
  std::uint64_t WindowAt(double begin) const;

  /// Visits the arrivals of windows [first, last) whose times are in [begin, end), in order.
  void Visit(std::uint64_t seed, std::uint64_t first, std::uint64_t last, double begin, double end,
             const std::function<void(const UniformArrival&)>& visit) const;

  /// Whether there is no arrival before `end` at all: cheaper to know than Visit. May say false
  /// although there is none.
  bool IsQuietUntil(std::uint64_t seed, double end) const;

 private:
  UniformArrival At(std::uint64_t seed, std::uint64_t number, double time) const;

  std::array<Vec3, 3> corner_;  // In the canonical rotation.
  int first_;                   // Which of the file's corners that begins with.
  double area_;
  std::uint64_t hash_, id_;
  Vec3 area_vector_;
};

}  // namespace strata
