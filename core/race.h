// The race: the roulette of the paper's section 2, run so that it can be merged.
//
// Points arrive on the surface as a Poisson process of intensity f(p) dA dt; the first arrival in a
// cell has exactly the density f / ∫f, and the earliest of several pieces' first arrivals is the
// first arrival on all of them. So every piece, on its own, draws its first arrival, and a cell
// keeps the earliest. docs/adr/0002 derives the envelopes.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>

#include "core/polygon.h"
#include "core/random_stream.h"

namespace strata {

/// Up to this product of lambda and radius a piece is drawn from with a crude bound of f, which
/// takes more proposals than a better one, but ones that the vector code makes.
inline constexpr double kCrude = 4.5;
/// Lifts a bound of f above its own rounding.
inline constexpr double kAboveRounding = 1 + 1e-12;
/// No envelope's rate is taken for less: every arrival has a finite time, however small the piece
/// and however large lambda.
inline constexpr double kLeastRate = 1e-300;

/// A first arrival.
struct Arrival {
  double time;  ///< In units of 1 / (f · cell faces); earlier wins.
  Vec3 local;   ///< Position relative to the cell's centre, in edges.
};

/// Draws the first arrival on the convex polygon `piece`, or nothing when it comes later than
/// `rival`. `rival` never changes an arrival, it only saves the work of drawing one that loses.
///
/// `piece` is relative to the cell's centre, in edges, at least 3 corners, counter-clockwise about
/// `normal`, the unit normal of its plane; `area` (> 0) its area in edges squared. Density
/// exp(-lambda * |p|), 0 <= lambda <= kMaxLambda. Pure: same arguments, same arrival. Cost: O(1)
/// expected draws whatever the piece and lambda; no allocation.
std::optional<Arrival> DrawFirstArrival(const Polygon& piece, Vec3 normal, double area,
                                        double lambda, const RandomStream& random,
                                        double rival = std::numeric_limits<double>::infinity());

}  // namespace strata
