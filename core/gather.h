// From reservoirs to samples: the minimum distance, and what survives it in canonical order.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/cell_octree.h"
#include "core/lattice.h"
#include "core/mesh_reader.h"
#include "core/reservoir_store.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/samples.h"
#include "core/territory.h"

namespace strata {

struct GatherOptions {
  Lattice lattice;
  Bounds surface;  ///< Of the surface, world units: no sample lies outside.
  double min_distance = 0.5;
  double lambda = 5;  ///< Of the density: for kWeight.
  AttributeSet attributes = kNormal;
  /// Whether a sample may lie outside its cell (Integrator::kSubdivide).
  bool samples_leave_cells = false;
  std::uint64_t parcel_cells = 0;  ///< Of a parcel, at most; 0 = no parcels.
};

/// What is known before the first sample leaves.
struct Gathered {
  std::unique_ptr<SampleSource> samples;
  std::uint64_t cells = 0;
  double cell_area = 0;  ///< Sum over the cells of the surface inside; world units squared.
  std::uint64_t survivors = 0;
  Bounds bounds;  ///< Of the survivors; world units.
  std::vector<OctreeNode> parcels;
  /// Of a territory, its blocks whose samples depend on blocks that are not there; then there are
  /// no samples. Ascending.
  std::vector<Cell> undecided;
  double reject_seconds = 0;
};

/// Memory that gathering in memory takes beside the grid, per occupied cell, at most.
inline constexpr std::uint64_t kGatherBytesPerCell = 276;

/// Gathers everything at once; the store must lie in memory. Call inside the arena that is to be
/// used. Errors: kCancelled.
Result<Gathered> GatherInMemory(std::unique_ptr<ReservoirStore> store, const GatherOptions& options,
                                RunContext& context);

/// The same samples in as much memory as is left of the context's account: three passes over the
/// blocks (their places; the minimum distance; the samples). Errors: kIo, kCancelled,
/// kOverBudget when samples that hang together by their distances need more.
/// Of a store that holds part of all blocks, `territory` says what is to be gathered of it: counts,
/// sums and samples are those of the territory, whose nodes are the parcels.
Result<Gathered> GatherInPasses(std::unique_ptr<ReservoirStore> store, const GatherOptions& options,
                                RunContext& context,
                                std::unique_ptr<const Territory> territory = nullptr);

}  // namespace strata
