// Racing the triangles of a batch: what the vector kernel bounds, splits and draws, brought
// together with the reservoirs of the cells.
#pragma once

#include <cstdint>
#include <vector>

#include "core/cell_race.h"
#include "core/mesh_reader.h"
#include "core/scan_kernel.h"

namespace strata {

/// A batch and what ClassifyTriangles found of it.
struct ClassifiedBatch {
  const TriangleBatch& batch;
  TriangleLanes& lanes;
};

/// The triangle number `i` of a batch, ready to be raced.
RaceTriangle PrepareTriangle(const ClassifiedBatch& in, std::size_t i, const Lattice& lattice);

/// A worker's buffers and its place to put arrivals. Threads: one.
class BatchRacer {
 public:
  /// For batches of up to `capacity` triangles. Memory: about 15 MB, used as needed.
  BatchRacer(ReservoirStore& store, const ScanParameters& parameters, const RaceOptions& options,
             std::size_t capacity);

  /// Races the triangles that are kInside, kSmall or kMedium.
  void Race(const ClassifiedBatch& in);

  /// Cuts slabs [begin, end) of the large triangle number `i` and gathers the pieces; RaceGathered
  /// must follow before the batch ends. Returns false when the store is full or the context
  /// cancelled.
  bool GatherPieces(const ClassifiedBatch& in, const RaceTriangle& triangle, std::size_t i,
                    const SlabRange& slabs, std::int32_t begin, std::int32_t end,
                    const RunContext& context);
  void RaceGathered(const ClassifiedBatch& in);

  ReservoirSink& sink() { return sink_; }
  /// Pairs of a triangle and a cell that have met, so far.
  std::uint64_t pieces() const { return pieces_; }
  void AddPieces(std::uint64_t n) { pieces_ += n; }
  /// Triangles that Race found to cross lattice planes and yet to have no piece, so far: they are
  /// thinner than the rounding of their corners.
  std::uint64_t thin() const { return thin_; }

 private:
  // A part that may win its cell.
  struct Contender {
    double bound;         // It arrives no earlier.
    std::uint32_t entry;  // Of its cell in the cache.
    std::uint32_t place;  // Of the triangle in the batch, or of the part in the split parts.
    bool split;
  };

  void RaceSplit(const ClassifiedBatch& in, SplitQueue& queue, std::size_t chunk);
  void CountPieces(SplitQueue& queue, std::size_t begin, std::size_t end);
  void AddPiece(const RaceTriangle& triangle, std::size_t root, const SlabRange& slabs,
                const Polygon& piece, Cell cell);
  void EnterInside(const ClassifiedBatch& in);
  void EnterParts(const ClassifiedBatch& in);
  template <class Numbers>
  void EnterAll(const ClassifiedBatch& in, CellParts& cells, std::size_t count, bool split,
                Numbers&& number);
  std::uint32_t Admit(const ClassifiedBatch& in, Cell cell, std::uint32_t hash);
  void RaceContenders(const ClassifiedBatch& in);
  void Favour(LiveCell& live, std::uint32_t i);
  void Draw(const ClassifiedBatch& in, std::uint32_t number);
  void DrawPending(const ClassifiedBatch& in);
  void RaceHere(const ClassifiedBatch& in, const Contender& contender);
  std::size_t RootOf(const Contender& contender);
  int CornersOf(const ClassifiedBatch& in, const Contender& contender, Vec3 (&out)[4]);
  double AreaOf(const ClassifiedBatch& in, const Contender& contender);

  const ScanParameters& parameters_;
  double per_edge_, per_face_;
  ReservoirSink sink_;
  SplitParts parts_;
  SplitQueue scratch_[2];
  DrawLanes draws_;
  std::vector<std::uint32_t> drawn_;  // Numbers of the contenders in `draws_`.
  std::vector<Contender> contenders_;
  std::vector<std::uint64_t> touched_;  // Per triangle: in which of 4^3 cells it has a part.
  std::uint64_t pieces_ = 0, thin_ = 0;
};

}  // namespace strata
