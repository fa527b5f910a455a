// The law that samples must follow, computed without any of the core's code: long-double clipping
// and adaptive quadrature of exp(-lambda * d).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "tests/support/memory_mesh.h"
#include "tests/support/statistics.h"

namespace strata::test {

/// A point in long double.
struct LongVec {
  long double x = 0, y = 0, z = 0;
  long double& operator[](int a) { return a == 0 ? x : a == 1 ? y : z; }
  long double operator[](int a) const { return a == 0 ? x : a == 1 ? y : z; }
};
using LongPolygon = std::vector<LongVec>;

/// The part of `polygon` with low <= coordinate <= high on `axis`.
LongPolygon ClipToSlab(const LongPolygon& polygon, int axis, long double low, long double high);
/// The part of `polygon` in the closed box.
LongPolygon ClipToBox(LongPolygon polygon, const LongVec& low, const LongVec& high);
long double AreaOfPolygon(const LongPolygon& polygon);
LongPolygon ToLong(const Triangle& triangle);
/// Polygon minus a point.
LongPolygon Shifted(LongPolygon polygon, const LongVec& by);

/// ∫ exp(-lambda |p|) over a polygon, relative error below 1e-5.
double IntegralOfDensity(const LongPolygon& polygon, double lambda);

/// What is compared beside the boxes: moments, which see small errors that are spread over all
/// boxes.
inline constexpr std::size_t kMomentCount = 4;
inline constexpr std::array<const char*, kMomentCount> kMomentNames = {"distance", "x", "y", "z"};
using Moments = std::array<double, kMomentCount>;
Moments MomentsOf(double x, double y, double z);

/// The law in one cell, in coordinates relative to the cell's centre, tabulated over boxes.
class CellLaw {
 public:
  /// `surface`: the polygons in the cell. `per_axis`: boxes wanted per axis; their borders are
  /// quantiles of the law itself, so that they hold comparable mass whatever lambda is.
  CellLaw(const std::vector<LongPolygon>& surface, double lambda, int per_axis);

  std::size_t bins() const { return probability_.size(); }
  std::size_t BinOf(Vec3 local) const;
  const std::vector<double>& probability() const { return probability_; }
  double mass() const { return mass_; }
  const Moments& mean() const { return mean_; }
  const Moments& variance() const { return variance_; }

 private:
  std::array<std::vector<double>, 3> borders_;
  std::vector<double> probability_;
  double mass_ = 0;
  Moments mean_{}, variance_{};
};

}  // namespace strata::test
