// The two halves of the main job, which may run on different machines.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>

#include "core/parcels.h"
#include "core/reservoir_store.h"
#include "core/sample_mesh.h"
#include "core/scan.h"
#include "core/triangle_hash.h"

namespace strata {

struct Partial;

/// What a scan leaves. Of `stats` everything up to the samples is known.
struct ScannedMesh {
  SampleStats stats;
  SurfaceHash surface;
  std::unique_ptr<ReservoirStore> store;
};

/// The lattice for a surface within `bounds`; for Height in passes over `reader`, which it adds to
/// `passes`. Errors: the reader's; kOverBudget when the edge is out of kMinEdge to kMaxEdge.
Result<Lattice> FindLattice(MeshReader& reader, const LatticeSpec& spec, const Bounds& bounds,
                            int& passes, RunContext& context);

/// Whether the options are within their ranges. Errors: kInvalidArgument.
Result<void> CheckOptions(const SampleOptions& options);

/// 32 hex digits.
std::string HexOf(const SurfaceHash& surface);

/// Scans one share of the triangles of `reader`, of which nothing was read since opening or Rewind;
/// other shares' are not even read where the file allows it, and the share stays selected. Over all
/// shares stats.read, skipped, sampled and pieces add up to the whole mesh's. Without `lattice` a
/// share of several finds the lattice in passes over the whole surface; `lattice`, if given, must
/// be what those would find. Errors: as SampleMesh; a share may hold no triangle; kInvalidArgument
/// for Method::kUniform, whose samples are not decided share by share.
Result<ScannedMesh> ScanMesh(MeshReader& reader, const SampleOptions& options, const Share& share,
                             const std::optional<Lattice>& lattice, RunContext& context);

/// Decides the samples of a whole surface. Errors: as SampleMesh.
Result<SampledMesh> GatherSamples(ScannedMesh scanned, const SampleOptions& options,
                                  RunContext& context);

/// Decides those in one region's parcels, with the parcels themselves, from `parts`, which are
/// together all that GatherSamples would take from the store; the store itself is not used, and may
/// be null. Over all regions these are the very samples of GatherSamples. Of the stats the counts
/// of cells and samples, and their area, are the region's. A region may have no parcel: then it has
/// no source of samples. Errors: as SampleMesh; kCorruptInput for a damaged part.
Result<SampledMesh> GatherRegion(ScannedMesh scanned, std::span<const Partial> parts,
                                 const Region& region, const SampleOptions& options,
                                 RunContext& context);

}  // namespace strata
