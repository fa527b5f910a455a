#include "io/float_grid.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

namespace strata::io {
namespace {

// Steps and coordinates stay between these, so that no float32 is subnormal or infinite.
constexpr double kSmallestStep = 0x1p-100;
constexpr double kLargest = 0x1p+100;
constexpr double kExactInFloat = 0x1p+24;
// A step of several significant bits is closer to what was asked than a power of two, at the price
// of quantisers multiplying by an inexact 1/step: harmless while bits + kept bits stay below this.
constexpr double kExactInDouble = 0x1p+52;
constexpr int kMaxKeptBits = 6;
constexpr int kInexactInverseBits = 22;

const double kSqrt3 = std::sqrt(3.0);

double LargestCoordinate(const Bounds& box) {
  double largest = 0;
  for (int a = 0; a < 3; ++a) {
    largest = std::max({largest, std::abs(box.min[a]), std::abs(box.max[a])});
  }
  return largest;
}

double LargestExtent(const Bounds& box) {
  double extent = 0;
  for (int a = 0; a < 3; ++a) extent = std::max(extent, box.max[a] - box.min[a]);
  return extent;
}

// What the subtractions and additions in double may cost along an axis.
double DoubleSlack(const Bounds& box) { return LargestCoordinate(box) * 0x1p-51; }

// x cut to `kept` significant bits, and the weight of the last of them.
struct CutNumber {
  double value, unit;
};
CutNumber Cut(double x, int kept) {
  int exponent = 0;
  const double fraction = std::frexp(x, &exponent);
  const double unit = std::ldexp(1.0, exponent - kept);
  return {std::floor(std::ldexp(fraction, kept)) * unit, unit};
}

std::optional<FloatGrid> TryGrid(const Bounds& box, CutNumber step, int kept, bool shifted) {
  FloatGrid grid;
  grid.step = step.value;
  double most = 0, largest = 0;
  for (int a = 0; a < 3; ++a) {
    const double front = std::floor(box.min[a] / step.value) * step.value;
    (shifted ? grid.offset : grid.origin)[a] = front;
    // One more than the last, because of rounding in double.
    const double last = std::ceil((box.max[a] - front) / step.value) + 1;
    most = std::max(most, last);
    if (!shifted) largest = std::max({largest, std::abs(front), front + last * step.value});
  }
  if (!(most < std::ldexp(1.0, FloatGrid::kMaxBits))) return std::nullopt;
  while (std::ldexp(1.0, grid.bits) - 1 < most) ++grid.bits;
  if (kept > 1 && grid.bits + kept > kInexactInverseBits) return std::nullopt;
  if (largest / step.unit > kExactInFloat || largest > kLargest) return std::nullopt;
  return grid;
}

// The step is a power of two here, because that reaches furthest.
double SmallestError(const Bounds& box) {
  const double extent = LargestExtent(box);
  int exponent = 0;
  std::frexp(extent / (std::ldexp(1.0, FloatGrid::kMaxBits) - 8), &exponent);
  const double step =
      extent > 0 ? std::max(std::ldexp(1.0, exponent), kSmallestStep) : kSmallestStep;
  return (step / 2 * (1 + 1e-8) + DoubleSlack(box)) * kSqrt3;
}

tl::unexpected<Error> FailTooFine(const Bounds& box, double max_error, const std::string& name) {
  char text[256];
  // Rounded up: what is printed shall itself be accepted.
  std::snprintf(text, sizeof text,
                ": a position error of %.6g is finer than 32-bit floats hold over the samples' "
                "extent; the smallest possible is %.6g",
                max_error, SmallestError(box) * (1 + 1e-5));
  return Fail(ErrorCode::kOverBudget, name + text);
}

bool IsFinite(const Bounds& box) {
  for (int a = 0; a < 3; ++a) {
    if (!(box.min[a] <= box.max[a]) || !std::isfinite(box.max[a] - box.min[a])) return false;
  }
  return true;
}

// Whether every box within `whole` and up to `extent` wide has a grid of this step: what TryGrid
// asks, of the worst of them.
bool HasTileGrids(const Bounds& whole, double extent, CutNumber step, const TileLattice& lattice) {
  const double most = std::ceil(extent / step.value) + 3;
  const double largest = LargestCoordinate(whole) + 3 * step.value;
  if (largest / step.unit > kExactInDouble || !(most < std::ldexp(1.0, FloatGrid::kMaxBits))) {
    return false;
  }
  int bits = 1;
  while (std::ldexp(1.0, bits) - 1 < most) ++bits;
  if (lattice.kept > 1 && bits + lattice.kept > kInexactInverseBits) return false;
  return lattice.shifted || (largest / step.unit <= kExactInFloat && largest <= kLargest);
}

}  // namespace

double LargestGridStep(const Bounds& box, double max_error) {
  const double along_axis = max_error / kSqrt3 - DoubleSlack(box);
  return std::min(2 * along_axis * (1 - 1e-9), kLargest);
}

std::array<double, 3> FloatGrid::Quantize(Vec3 p) const {
  std::array<double, 3> q;
  for (int a = 0; a < 3; ++a) {
    // Only one of the two is not zero, and the difference rounds once.
    const double from = offset[a] != 0 ? offset[a] : origin[a];
    q[static_cast<std::size_t>(a)] = std::floor((p[a] - from) / step + 0.5);
  }
  return q;
}

std::array<float, 3> FloatGrid::ValueAt(const std::array<double, 3>& q) const {
  return {static_cast<float>(origin.x + step * q[0]), static_cast<float>(origin.y + step * q[1]),
          static_cast<float>(origin.z + step * q[2])};
}

Result<FloatGrid> ChooseFloatGrid(const Bounds& box, double max_error, const std::string& name) {
  if (!IsFinite(box)) {
    return Fail(ErrorCode::kInternal, name + ": the samples' bounds are not a finite box");
  }
  const double step = LargestGridStep(box, max_error);
  if (!(step >= kSmallestStep)) return FailTooFine(box, max_error, name);
  for (const bool shifted : {false, true}) {
    for (int kept = kMaxKeptBits; kept >= 1; --kept) {
      if (auto grid = TryGrid(box, Cut(step, kept), kept, shifted)) return *grid;
    }
  }
  return FailTooFine(box, max_error, name);
}

Result<TileLattice> ChooseTileLattice(const Bounds& whole, double max_error,
                                      const std::string& name) {
  if (!IsFinite(whole)) {
    return Fail(ErrorCode::kInternal, name + ": the surface's bounds are not a finite box");
  }
  const double step = LargestGridStep(whole, max_error);
  if (!(step >= kSmallestStep)) return FailTooFine(whole, max_error, name);
  const double extent = std::min(LargestExtent(whole), kMostTileSteps * step);
  for (const bool shifted : {false, true}) {
    for (int kept = kMaxKeptBits; kept >= 1; --kept) {
      const CutNumber cut = Cut(step, kept);
      const TileLattice lattice{cut.value, cut.unit, kept, shifted};
      if (HasTileGrids(whole, extent, cut, lattice)) return lattice;
    }
  }
  return FailTooFine(whole, max_error, name);
}

Result<FloatGrid> TileGrid(const TileLattice& lattice, const Bounds& box, const std::string& name) {
  const auto grid =
      TryGrid(box, CutNumber{lattice.step, lattice.unit}, lattice.kept, lattice.shifted);
  if (grid) return *grid;
  return Fail(ErrorCode::kOverBudget,
              name +
                  ": its samples lie too far apart for one grid of 32-bit floats; use a larger "
                  "position error");
}

}  // namespace strata::io
