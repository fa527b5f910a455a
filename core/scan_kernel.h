// The hot loop: what can be said of a triangle without drawing anything exact.
//
// Vector code, chosen at run time for the processor (Highway). It computes per triangle the cell,
// the area, the hash and a lower bound of its arrival time; triangles that cross lattice planes it
// splits until each part lies in one cell. It decides nothing that could differ between processors:
// cells, areas and hashes are exact functions in plain IEEE and integer operations, and the bound
// may only discard what, with a margin for rounding, cannot win. What might win goes to the one
// scalar path (core/race.h).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <vector>

#include "core/lattice.h"
#include "core/mesh_reader.h"
#include "core/reservoir.h"
#include "core/triangle_hash.h"
#include "core/vec3.h"

namespace strata {

/// Lattice planes a coordinate may be away from the origin; beyond it doubles get coarse.
inline constexpr double kMaxCellCoordinate = 0x1p30;

/// What the kernel needs to know of a job.
struct ScanParameters {
  Lattice lattice;
  double lambda = 5;
  std::uint64_t seed = 0;
  /// Hashes of vertices whose presence on the surface is to be reported, at most 8.
  std::vector<std::uint64_t> probes;
};

/// What became of a triangle.
enum class TriangleKind : std::uint64_t {
  kInside,    ///< Within one cell.
  kSmall,     ///< Crosses at most one lattice plane on each axis: split here, into SplitParts.
  kMedium,    ///< At most three: split here as well.
  kLarge,     ///< Crosses more: left to the caller.
  kUnusable,  ///< No positive, finite area.
  kFar,       ///< Beyond kMaxCellCoordinate.
};

/// An array with room for a vector's overshoot; 64-byte aligned, not initialised (so that room that
/// is never used costs no memory).
template <class T>
class LaneArray {
 public:
  explicit LaneArray(std::size_t n)
      : storage_(static_cast<T*>(::operator new((n + kPad) * sizeof(T), kAlign))) {}
  T* data() { return storage_.get(); }
  T& operator[](std::size_t i) { return storage_.get()[i]; }

 private:
  static constexpr std::size_t kPad = 32;
  static constexpr std::align_val_t kAlign{64};
  struct Free {
    void operator()(T* p) const { ::operator delete(p, kAlign); }
  };
  std::unique_ptr<T, Free> storage_;
};

/// Triangles, or parts of them, that lie within one cell each; columns of equal length.
struct CellParts {
  explicit CellParts(std::size_t n) : time_bound(n), area(n), x(n), y(n), z(n), cell_hash(n) {}
  LaneArray<double> time_bound;  ///< The first arrival comes no earlier.
  LaneArray<FixedArea> area;
  LaneArray<std::int32_t> x, y, z;
  LaneArray<std::uint32_t> cell_hash;  ///< HashCell of (x, y, z).

  Cell cell(std::size_t i) { return {x[i], y[i], z[i]}; }
};

/// A set of triangles in cell units (columns as in TriangleBatch), on their way to being split.
struct SplitQueue {
  explicit SplitQueue(std::size_t n)
      : corner{LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n),
               LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n),
               LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n)},
        root_area(n),
        hash(n),
        root(n),
        part(n) {}
  std::array<LaneArray<double>, 9> corner;
  LaneArray<double> root_area;    ///< Area of the whole triangle, cell faces.
  LaneArray<std::uint64_t> hash;  ///< Of the whole triangle.
  LaneArray<std::uint64_t> root;  ///< Its place in the batch.
  LaneArray<std::uint64_t> part;  ///< The path of cuts that led here, base 4; 0 = whole.
  std::size_t size = 0;

  void SetCorner(std::size_t i, int v, Vec3 p) {
    const auto k = static_cast<std::size_t>(3 * v);
    corner[k][i] = p.x;
    corner[k + 1][i] = p.y;
    corner[k + 2][i] = p.z;
  }
  Vec3 Corner(std::size_t i, int v) {
    const auto k = static_cast<std::size_t>(3 * v);
    return {corner[k][i], corner[k + 1][i], corner[k + 2][i]};
  }
};

/// Parts of split triangles, each within one cell, with their geometry: triangles, or
/// quadrilaterals (in one plane, convex) where cutting off a tip left one whole within a cell.
struct SplitParts {
  explicit SplitParts(std::size_t n)
      : cells(n),
        geometry(n),
        area(n),
        fourth{LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n)} {}
  CellParts cells;
  SplitQueue geometry;                      ///< The first three corners.
  LaneArray<double> area;                   ///< Cell faces.
  std::array<LaneArray<double>, 3> fourth;  ///< Equal to the third for triangles.
};

/// How many parts a small and a medium triangle may come to: three at each cut.
inline constexpr std::size_t kSmallParts = 27, kMediumParts = 729;

/// What a call reports of the whole batch.
struct BatchTotals {
  SurfaceHash surface;  ///< Over the usable triangles.
  Bounds bounds;        ///< Of the usable triangles, world units.
  double area = 0;      ///< Of the usable triangles, world units squared.
  std::uint64_t usable = 0;
  std::uint32_t probes_found = 0;  ///< Bit i: probe i is a corner of a usable triangle.
};

/// Per triangle of a batch. Memory: about 150 bytes a triangle.
struct TriangleLanes {
  explicit TriangleLanes(std::size_t n)
      : cells(n),
        inside(n),
        rare(n),
        kind(n),
        hash(n),
        first(n),
        world_area(n),
        small(n),
        medium(n) {}
  CellParts cells;                  ///< For split ones: x, y, z of the bounding box's lowest cell.
  LaneArray<std::uint64_t> inside;  ///< The numbers of the kInside ones, ascending,
  std::size_t inside_size = 0;      ///< how many,
  LaneArray<std::uint64_t> rare;    ///< and of those neither inside nor split here,
  std::size_t rare_size = 0;        ///< how many.
  LaneArray<std::uint64_t> kind;    ///< TriangleKind
  LaneArray<std::uint64_t> hash;    ///< HashTriangle
  LaneArray<std::uint64_t> first;   ///< CanonicalFirst: which corner starts the canonical rotation.
  LaneArray<double> world_area;     ///< World units squared; 0 for unusable triangles.
  SplitQueue small, medium;         ///< The kSmall and kMedium ones, in canonical rotation.
  BatchTotals totals;
};

/// Classifies the triangles of `batch` (at most as many as `lanes` was made for). Pure but for
/// `lanes`. Threads: any, one `lanes` each.
void ClassifyTriangles(const TriangleBatch& batch, const ScanParameters& parameters,
                       TriangleLanes& lanes);

/// Splits the triangles [begin, end) of `queue` along lattice planes until every part lies in one
/// cell, and fills `parts`. Each triangle needs room for kSmallParts or kMediumParts in `parts`,
/// and a third of that in either scratch queue. Parts that are slivers of rounding are dropped;
/// never all of a triangle.
void SplitTriangles(SplitQueue& queue, std::size_t begin, std::size_t end,
                    const ScanParameters& parameters, SplitQueue& scratch, SplitQueue& scratch2,
                    SplitParts& parts);

/// Bound of parts that are only slivers of rounding.
inline constexpr double kDroppedPart = -1;

/// Completes `parts` that were cut elsewhere, which have their cell, their corners and what
/// geometry says of the triangle (as root_area what it has per cell, roughly): fills in bound, area
/// and hash of the cell. Slivers of rounding get the bound kDroppedPart.
void BoundParts(SplitParts& parts, const ScanParameters& parameters);

/// Parts, each within a cell, to be drawn for; columns of equal length.
struct DrawLanes {
  explicit DrawLanes(std::size_t n)
      : corner{LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n),
               LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n),
               LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n),
               LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n)},
        area(n),
        quad(n),
        counter(n),
        part(n),
        time(n),
        local{LaneArray<double>(n), LaneArray<double>(n), LaneArray<double>(n)},
        settled(n),
        open(n) {}
  std::array<LaneArray<double>, 12> corner;  ///< Relative to the cell's centre, in edges.
  LaneArray<double> area;                    ///< Cell faces.
  LaneArray<double> quad;                    ///< 1 where there is a fourth corner, else 0.
  LaneArray<std::uint64_t> counter, part;    ///< StreamCounter, and RandomStream's part.
  LaneArray<double> time;                    ///< Out: the first arrival
  std::array<LaneArray<double>, 3> local;    ///< and its place relative to the centre,
  LaneArray<std::uint64_t> settled;          ///< if this is 1; else ask DrawFirstArrival.
  LaneArray<std::uint64_t> open;             ///< Scratch: numbers of parts yet to be settled.
};

/// Draws first arrivals on the first `n` parts of `lanes` that are small (kCrude) and
/// accept one of the first few proposals, which is the common case. Twin of DrawFirstArrival: the
/// same operations in the same order, none of them fused, so the same bits on every processor; a
/// test compares them. lambda > 0.
void DrawParts(DrawLanes& lanes, std::size_t n, double lambda, std::uint64_t seed);

}  // namespace strata
