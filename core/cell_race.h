// Racing whole triangles: from a triangle in the world to the reservoirs of the cells it touches.
#pragma once

#include <cstdint>
#include <functional>

#include "core/cell_cache.h"
#include "core/polygon.h"
#include "core/reservoir.h"
#include "core/reservoir_store.h"
#include "core/run_context.h"
#include "core/scan_kernel.h"

namespace strata {

/// The middle of a cell, in cells from the lattice's origin.
inline Vec3 CenterOf(Cell cell) { return {cell.x + 0.5, cell.y + 0.5, cell.z + 0.5}; }

/// A triangle in canonical rotation, ready to be raced.
struct RaceTriangle {
  std::array<Vec3, 3> corner;  ///< In cells from the lattice's origin.
  Vec3 normal;                 ///< Unit.
  double area;                 ///< Cell faces.
  std::uint64_t hash;
  std::uint64_t id;  ///< In file order.
  int first;         ///< File-order number of corner[0].
};

/// Brings a triangle of the file into canonical rotation (corner number `first` leads) and cell
/// units. The same operations as the vector kernel, bit for bit. Precondition: its area is positive
/// and finite.
RaceTriangle PrepareTriangle(const std::array<Vec3, 3>& corner, int first, std::uint64_t hash,
                             std::uint64_t id, const Lattice& lattice);

/// Whether a sample needs more than position and normal.
struct RaceOptions {
  double lambda = 5;
  std::uint64_t seed = 0;
  bool barycentric = false;
};

/// A worker's place to put arrivals: its own cache, emptied into the shared store when full.
/// Threads: one per sink; the store may be shared.
class ReservoirSink {
 public:
  ReservoirSink(ReservoirStore& store, const RaceOptions& options, std::size_t cache_cells)
      : store_(store), options_(options), cache_(cache_cells) {}

  const RaceOptions& options() const { return options_; }
  /// Whether the store takes no more.
  bool over_limit() const { return store_.full(); }

  /// A cell's reservoir in the cache; valid until the next call of At or Flush.
  struct Slot {
    LiveCell& live;
    Reservoir& best;
  };
  /// The cache, for loops over many cells; entries are valid until Flush, the view until Add.
  CellCache::View View() { return cache_.view(); }
  /// Whether a Flush is due before the next Add.
  bool full() const { return cache_.full(); }
  /// The number of a new entry. Precondition: the cell has none, and !full().
  std::uint32_t Add(Cell cell, std::uint32_t hash) { return cache_.Add(cell, hash); }
  LiveCell& Live(std::size_t entry) { return cache_.live(entry); }
  Slot Entry(std::size_t entry) { return {cache_.live(entry), cache_.best(entry)}; }
  Slot At(Cell cell) {
    const std::uint32_t hash = HashCell(cell);
    std::uint32_t entry = cache_.view().Find(cell, hash);
    if (entry == CellCache::kNone) {
      if (cache_.full()) Flush();
      entry = cache_.Add(cell, hash);
    }
    return Entry(entry);
  }
  /// Moves everything into the store.
  void Flush() {
    cache_.Seal();
    store_.Merge(cache_);
    cache_.Clear();
  }

 private:
  ReservoirStore& store_;
  RaceOptions options_;
  CellCache cache_;
};

/// Draws the first arrival of one part of `triangle`, `piece` (in cells from the lattice's origin)
/// of `area` inside the slot's cell, and keeps it if it is the earliest there. Does not touch the
/// area total.
void RacePart(const RaceTriangle& triangle, const Polygon& piece, double area, std::uint32_t part,
              const RaceOptions& options, ReservoirSink::Slot slot);

/// Keeps an arrival at `local` (relative to the cell's centre) if it is the earliest in its cell.
void OfferSample(const RaceTriangle& triangle, Vec3 local, double time, const RaceOptions& options,
                 ReservoirSink::Slot slot);

/// How a large triangle is laid out over the lattice: slabs along `outer`, rows along `middle`,
/// runs along `inner`, the axis closest to its normal.
struct SlabRange {
  int outer, middle, inner;
  std::int32_t begin, end;  ///< Slabs touched.
  double cells;             ///< Rough number of cells.
};
SlabRange SlabsOf(const RaceTriangle& triangle);

/// Whether all pieces of `triangle` might be slivers of rounding.
bool IsThin(const RaceTriangle& triangle, const SlabRange& slabs);

/// Takes what a triangle leaves in a cell, in cells from the lattice's origin; false = stop.
using PieceVisitor = std::function<bool(const Polygon&, Cell)>;
/// Cuts `triangle` by slabs [begin, end) of `slabs` into cells. Any division into ranges gives the
/// same pieces. Some may be slivers of rounding. Returns whether it was not stopped.
bool CutIntoCells(const RaceTriangle& triangle, const SlabRange& slabs, std::int32_t begin,
                  std::int32_t end, const PieceVisitor& visit);

}  // namespace strata
