#include "core/subdivide.h"

#include <algorithm>
#include <cmath>

#include "core/numeric.h"
#include "core/random_stream.h"

namespace strata {
namespace {

// Section 2.1: r = 25, relative to the half edge in the authors' program.
constexpr double kTerminalArea = 0.25 / 25;

struct Corners {
  Vec3 a, b, c;
};

double MaxOf3(double a, double b, double c) { return std::max(a, std::max(b, c)); }
double MinOf3(double a, double b, double c) { return std::min(a, std::min(b, c)); }

// Whether the projections on `axis` of the triangle and of the cube |x|,|y|,|z| <= 1/2 overlap.
bool OverlapOnAxis(const Corners& t, Vec3 axis) {
  const double a = Dot(t.a, axis), b = Dot(t.b, axis), c = Dot(t.c, axis);
  const double reach = 0.5 * (std::fabs(axis.x) + std::fabs(axis.y) + std::fabs(axis.z));
  return MinOf3(a, b, c) <= reach && MaxOf3(a, b, c) >= -reach;
}

// Triangle against the unit cube around the origin, by separating axes (Akenine-Möller 2001).
bool OverlapsCube(const Corners& t) {
  const Vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (const Vec3& axis : axes) {
    if (!OverlapOnAxis(t, axis)) return false;
  }
  const Vec3 edges[3] = {t.b - t.a, t.c - t.b, t.a - t.c};
  if (!OverlapOnAxis(t, Cross(edges[0], edges[1]))) return false;
  for (const Vec3& edge : edges) {
    for (const Vec3& axis : axes) {
      if (!OverlapOnAxis(t, Cross(edge, axis))) return false;
    }
  }
  return true;
}

// One triangle in one cell.
class CellSubdivision {
 public:
  CellSubdivision(const RaceTriangle& triangle, Cell cell, ReservoirSink& sink)
      : triangle_(triangle), cell_(cell), sink_(sink) {}

  // Whether any part was raced.
  bool Run() {
    const Vec3 center{cell_.x + 0.5, cell_.y + 0.5, cell_.z + 0.5};
    const Corners t{triangle_.corner[0] - center, triangle_.corner[1] - center,
                    triangle_.corner[2] - center};
    if (triangle_.area <= kTerminalArea) {
      Race(t, triangle_.area);
    } else {
      Split(t, triangle_.area);
    }
    return raced_;
  }

 private:
  void Split(const Corners& t, double area) {
    if (!OverlapsCube(t)) return;
    if (area <= kTerminalArea) {
      Race(t, area);
      return;
    }
    const Vec3 ab = (t.a + t.b) * 0.5, bc = (t.b + t.c) * 0.5, ca = (t.c + t.a) * 0.5;
    const double quarter = 0.25 * area;
    Split({t.a, ab, ca}, quarter);
    Split({ab, t.b, bc}, quarter);
    Split({ca, bc, t.c}, quarter);
    Split({ab, bc, ca}, quarter);
  }

  void Race(const Corners& t, double area) {
    const RaceOptions& options = sink_.options();
    const ReservoirSink::Slot slot = sink_.At(cell_);
    slot.live.area = AddAreas(slot.live.area, ToFixedArea(area));
    raced_ = true;
    const Vec3 centroid = (t.a + t.b + t.c) * (1.0 / 3);
    const double weight = area * Exp(-options.lambda * Norm(centroid));
    const RandomStream random(options.seed, triangle_.hash, cell_, part_++);
    const auto block = random(0);
    const double time = NegLogOneMinus(UniformFrom(block[0], block[1])) / weight;
    if (time > slot.live.time) return;
    double u = UniformFrom(block[2]), v = UniformFrom(block[3]);
    if (u + v > 1) u = 1 - u, v = 1 - v;
    const Vec3 local = t.a + (t.b - t.a) * u + (t.c - t.a) * v;
    OfferSample(triangle_, local, time, options, slot);
  }

  const RaceTriangle& triangle_;
  Cell cell_;
  ReservoirSink& sink_;
  std::uint32_t part_ = 0;
  bool raced_ = false;
};

}  // namespace

std::uint64_t SubdivideTriangle(const RaceTriangle& triangle, ReservoirSink& sink,
                                const RunContext& context) {
  Bounds box;
  for (const Vec3& corner : triangle.corner) box.Add(corner);
  std::uint64_t cells = 0;
  for (std::int32_t x = FloorToInt(box.min.x); x <= FloorToInt(box.max.x); ++x) {
    for (std::int32_t y = FloorToInt(box.min.y); y <= FloorToInt(box.max.y); ++y) {
      if (context.cancelled() || sink.over_limit()) return cells;
      for (std::int32_t z = FloorToInt(box.min.z); z <= FloorToInt(box.max.z); ++z) {
        if (CellSubdivision(triangle, {x, y, z}, sink).Run()) ++cells;
      }
    }
  }
  return cells;
}

}  // namespace strata
