// Uniform samples: independent points, uniform by area.
//
// Points arrive on the surface as a Poisson process of unit rate per area and time; the first N are
// N independent uniform points, and so is every prefix of them. Each triangle draws its arrivals on
// its own (core/uniform_arrivals.h), so the samples are a function of surface, seed and N.
#pragma once

#include <cstdint>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/sample_mesh.h"

namespace strata {

/// Exactly options.count samples of the whole of `reader`, in the order of their arrival: those of
/// a smaller count are the first of those of a larger one. With count 0 the stratified method runs
/// first, and its samples are dropped once they are counted.
///
/// Coincident copies of a triangle count once, but in stats.mesh_area, of which each sample's area
/// is the N-th part. Stats of cells and pieces stay 0; `passes` counts those before the first
/// sample leaves. Memory: a third of what is left of the context's account at most (1.6 GB without
/// a limit); more samples than that holds take further passes over the mesh. No scratch space.
///
/// Errors: as SampleMeshStreamed; kOverBudget also when the surface reaches more than 2^30 cells
/// from the lattice's origin. Reader and context must outlive the samples. Threads: as
/// SampleMeshStreamed; the source's Next uses as many.
Result<SampledMesh> SampleUniform(MeshReader& reader, const SampleOptions& options,
                                  RunContext& context);

}  // namespace strata
