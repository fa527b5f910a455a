#include "core/cell_race.h"

#include <algorithm>
#include <cmath>

#include "core/numeric.h"
#include "core/race.h"
#include "core/triangle_hash.h"

namespace strata {
namespace {

// The lowest and the highest slab with more than a touch of [min, max]; a flat extent lies in one.
struct Slabs {
  std::int32_t first, last;
};
Slabs SlabsTouched(Extent e) {
  const std::int32_t first = FloorToInt(e.min);
  return {first, std::max(first, CeilToInt(e.max) - 1)};
}

Polygon AsPolygon(const RaceTriangle& t) {
  Polygon p;
  for (const Vec3& corner : t.corner) p.Push(corner);
  return p;
}

Vec3f AsFloat(Vec3 v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

// To a multiple of 2^-50: then the sum of three weights is 1 exactly, whichever of them is computed
// from the other two, and what is interpolated does not depend on the corner that comes first.
double OnGrid(double weight) { return RoundToInteger(weight * 0x1p50) * 0x1p-50; }

// Barycentric weights of p on the corners in file order: second and third.
std::array<double, 2> FileOrderWeights(const RaceTriangle& t, Vec3 p) {
  const Vec3 ab = t.corner[1] - t.corner[0], ac = t.corner[2] - t.corner[0], ap = p - t.corner[0];
  const Vec3 n = Cross(ab, ac);
  const double n2 = Norm2(n);
  std::array<double, 3> w{};  // Of corner[0..2].
  w[1] = OnGrid(std::clamp(Dot(Cross(ap, ac), n) / n2, 0.0, 1.0));
  w[2] = OnGrid(std::clamp(Dot(Cross(ab, ap), n) / n2, 0.0, 1.0 - w[1]));
  w[0] = 1 - w[1] - w[2];
  // corner[k] is number (first + k) % 3 of the file.
  const auto number = [&](int file) { return static_cast<std::size_t>((file + 3 - t.first) % 3); };
  return {w[number(1)], w[number(2)]};
}

// Cuts a convex polygon into the slabs of an axis, from the lowest on, and hands each part over
// until `visit` returns false. What a slab gets is a function of the polygon alone, so any polygon
// must be cut as a whole.
template <class F>
void ForEachSlab(const Polygon& polygon, int axis, F&& visit) {
  const Slabs slabs = SlabsTouched(ExtentOf(polygon, axis));
  if (slabs.first == slabs.last) {
    visit(polygon, slabs.first);
    return;
  }
  Polygon rest[2], part;
  CutPolygon(polygon, axis, slabs.first + 1.0, part, rest[0]);
  for (std::int32_t k = slabs.first;;) {
    if (part.size >= 3 && !visit(part, k)) return;
    const Polygon& left = rest[(k - slabs.first) & 1];
    if (++k == slabs.last || left.size < 3) {
      if (left.size >= 3) visit(left, k);
      return;
    }
    CutPolygon(left, axis, k + 1.0, part, rest[(k - slabs.first) & 1]);
  }
}

// Races the pieces of one large triangle.
Cell CellAt(const SlabRange& slabs, std::int32_t outer, std::int32_t middle, std::int32_t inner) {
  std::int32_t at[3];
  at[slabs.outer] = outer;
  at[slabs.middle] = middle;
  at[slabs.inner] = inner;
  return {at[0], at[1], at[2]};
}

// The part of a triangle in slab i of an axis.
Polygon InSlab(const Polygon& whole, int axis, std::int32_t i) {
  Polygon below, above, inside;
  CutPolygon(whole, axis, i, below, above);
  if (above.size < 3) return above;
  CutPolygon(above, axis, i + 1.0, inside, below);
  return inside;
}

}  // namespace

RaceTriangle PrepareTriangle(const std::array<Vec3, 3>& corner, int first, std::uint64_t hash,
                             std::uint64_t id, const Lattice& lattice) {
  RaceTriangle t;
  t.first = first;
  t.hash = hash;
  t.id = id;
  const auto world = [&](int k) { return corner[static_cast<std::size_t>((first + k) % 3)]; };
  const Vec3 a = world(0), b = world(1), c = world(2);
  const Vec3 n = Cross(b - a, c - a);
  const double length = Norm(n), per_edge = 1 / lattice.edge;
  t.normal = n * (1 / length);
  t.area = 0.5 * length * (per_edge * per_edge);
  t.corner = {(a - lattice.origin) * per_edge, (b - lattice.origin) * per_edge,
              (c - lattice.origin) * per_edge};
  return t;
}

void OfferSample(const RaceTriangle& triangle, Vec3 local, double time, const RaceOptions& options,
                 ReservoirSink::Slot slot) {
  Reservoir& best = slot.best;
  best.time = slot.live.time;
  Reservoir candidate;
  candidate.time = time;
  candidate.hash = triangle.hash;
  candidate.triangle = triangle.id;
  if (!candidate.Beats(best)) return;
  slot.live.time = time;
  candidate.local = local;
  candidate.normal = AsFloat(triangle.normal);
  if (options.barycentric) {
    const auto weights = FileOrderWeights(triangle, CenterOf(slot.live.cell) + local);
    candidate.barycentric[0] = weights[0];
    candidate.barycentric[1] = weights[1];
  }
  best = candidate;
}

void RacePart(const RaceTriangle& triangle, const Polygon& piece, double area, std::uint32_t part,
              const RaceOptions& options, ReservoirSink::Slot slot) {
  Polygon local;
  const Vec3 center = CenterOf(slot.live.cell);
  for (int i = 0; i < piece.size; ++i) local.Push(piece[i] - center);
  const RandomStream random(options.seed, triangle.hash, slot.live.cell, part);
  const auto arrival =
      DrawFirstArrival(local, triangle.normal, area, options.lambda, random, slot.live.time);
  if (arrival) OfferSample(triangle, arrival->local, arrival->time, options, slot);
}

SlabRange SlabsOf(const RaceTriangle& triangle) {
  const Vec3 n{std::fabs(triangle.normal.x), std::fabs(triangle.normal.y),
               std::fabs(triangle.normal.z)};
  SlabRange slabs{};
  slabs.inner = n.z >= n.x && n.z >= n.y ? 2 : n.y >= n.x ? 1 : 0;
  const Polygon p = AsPolygon(triangle);
  const int a = (slabs.inner + 1) % 3, b = (slabs.inner + 2) % 3;
  const Extent ea = ExtentOf(p, a), eb = ExtentOf(p, b);
  const bool a_longer = ea.max - ea.min >= eb.max - eb.min;
  slabs.outer = a_longer ? a : b;
  slabs.middle = a_longer ? b : a;
  const Slabs touched = SlabsTouched(a_longer ? ea : eb);
  slabs.begin = touched.first;
  slabs.end = touched.last + 1;
  slabs.cells = (ea.max - ea.min + 1) * (eb.max - eb.min + 1);
  return slabs;
}

bool IsThin(const RaceTriangle& t, const SlabRange& slabs) {
  double reach = 1;
  for (const Vec3& c : t.corner) {
    reach = std::max({reach, std::fabs(c.x), std::fabs(c.y), std::fabs(c.z)});
  }
  const double area = 0.5 * Norm(Cross(t.corner[1] - t.corner[0], t.corner[2] - t.corner[0]));
  // If each piece is below the kernel's threshold, the whole is well below this.
  return !(area > 0x1p-44 * reach * slabs.cells);
}

bool CutIntoCells(const RaceTriangle& triangle, const SlabRange& slabs, std::int32_t begin,
                  std::int32_t end, const PieceVisitor& visit) {
  const Polygon whole = AsPolygon(triangle);
  bool go_on = true;
  for (std::int32_t i = begin; i < end && go_on; ++i) {
    const Polygon slab = InSlab(whole, slabs.outer, i);
    if (slab.size < 3) continue;
    ForEachSlab(slab, slabs.middle, [&](const Polygon& row, std::int32_t j) {
      ForEachSlab(row, slabs.inner, [&](const Polygon& piece, std::int32_t k) {
        go_on = visit(piece, CellAt(slabs, i, j, k));
        return go_on;
      });
      return go_on;
    });
  }
  return go_on;
}

}  // namespace strata
