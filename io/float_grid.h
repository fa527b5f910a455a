// A grid of points that 32-bit floats hold exactly, for formats whose positions are quantised
// floats.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/vec3.h"

namespace strata::io {

/// The points offset + origin + step * q, q a triple of integers in [0, 2^bits).
///
/// origin, step * q and their sum are exact in float32 for every q up to the box's far corner, and
/// so are origin and range() themselves: quantising and dequantising in float arithmetic lose
/// nothing. What is lost is lost in Quantize alone.
struct FloatGrid {
  Vec3 offset;  ///< Zero unless float32 is too coarse at the world coordinates' size.
  Vec3 origin;  ///< Zero if offset is not.
  double step = 1;
  int bits = 1;  ///< 1 to kMaxBits.

  /// More would break the rounding `floor(x + 0.5f)` of quantisers that work in float32.
  static constexpr int kMaxBits = 23;

  double range() const { return step * (static_cast<double>(std::uint32_t{1} << bits) - 1); }
  /// The nearest grid point's q; in [0, 2^bits) for a point of the box.
  std::array<double, 3> Quantize(Vec3 p) const;
  /// origin + step * q.
  std::array<float, 3> ValueAt(const std::array<double, 3>& q) const;
};

/// A grid over `box` whose step is the largest possible, so that no point of the box is further
/// than `max_error` from the grid point that Quantize names, the sum `offset + value` in double
/// included.
///
/// Errors: kOverBudget when no such grid exists; the message names the smallest error for which one
/// does. kInternal for an empty box or one that is not finite. `name` begins the messages.
Result<FloatGrid> ChooseFloatGrid(const Bounds& box, double max_error, const std::string& name);

/// The largest step that keeps every point of `box` within `max_error` of a grid point; zero or
/// less when rounding in double alone costs more.
double LargestGridStep(const Bounds& box, double max_error);

/// A lattice of positions that many grids are parts of: whole multiples of one step.
struct TileLattice {
  double step = 1;
  double unit = 1;       ///< The weight of the step's last significant bit.
  int kept = 1;          ///< The step's significant bits.
  bool shifted = false;  ///< Whether grids have offsets; else they have origins.
};

/// So many of the largest steps wide a box may always be.
inline constexpr double kMostTileSteps = 0x1p21;

/// The lattice with the largest step that keeps every point of `whole` within `max_error` and of
/// which every box within `whole`, up to kMostTileSteps of the largest steps wide, has a grid. A
/// function of the two alone, so that boxes can be gridded one by one. The step is no smaller than
/// half of LargestGridStep(whole, max_error). Errors: as ChooseFloatGrid.
Result<TileLattice> ChooseTileLattice(const Bounds& whole, double max_error,
                                      const std::string& name);

/// The part of the lattice around `box`, which lies within the lattice's whole: offset + origin is
/// a whole multiple of the step, and so is every sum offset + value, which double holds exactly.
/// The same point of the lattice is the same double in every grid.
/// Errors: kOverBudget for a box that is too wide for the step.
Result<FloatGrid> TileGrid(const TileLattice& lattice, const Bounds& box, const std::string& name);

}  // namespace strata::io
