// Partials: what `strata scan` writes for its share of the triangles, and what merges.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/run_file.h"
#include "core/scan_mesh.h"

namespace strata {

/// What a partial holds beside its reservoirs.
struct PartialInfo {
  // --- Equal for all partials of a job.
  std::string version;  ///< Strata's own.
  /// Which file: a digest, so that partials of different meshes are not mixed up.
  std::array<std::uint64_t, 4> mesh{};
  LatticeSpec spec;  ///< What was asked for, and what it came to.
  Lattice lattice;
  double lambda = 5;
  std::uint64_t seed = 0;
  Integrator integrator = Integrator::kExact;
  bool barycentric = false;
  std::uint32_t share_count = 1;
  // --- Of the shares it holds.
  std::vector<std::uint32_t> shares;  ///< Ascending.
  SurfaceHash surface;
  Bounds bounds;
  double mesh_area = 0;
  ReadCounts read;
  SkipCounts skipped{};
  std::uint64_t sampled = 0, pieces = 0;

  bool complete() const { return shares.size() == share_count; }
};

/// What ScanMesh left, as a partial's info. `options` are those of the scan.
PartialInfo PartialOf(const ScannedMesh& scanned, const SampleOptions& options, const Share& share,
                      const std::array<std::uint64_t, 4>& mesh);

/// Writes a partial: its info, and all blocks of `store`. Errors: kIo, kCorruptInput (a damaged
/// run), kCancelled.
Result<void> WritePartial(const AppendBytes& append, const PartialInfo& info, ReservoirStore& store,
                          RunContext& context);

/// An open partial.
struct Partial {
  PartialInfo info;
  std::shared_ptr<const ScratchFile> file;
  RunExtent run;  ///< Its blocks and cells are not known yet.
};

/// Reads a partial's info. Takes the file over. Errors: kIo; kCorruptInput, kUnsupported (another
/// format or version of it), naming the file.
Result<Partial> OpenPartial(std::unique_ptr<ScratchFile> file);

/// Puts partials of one job together. One that holds only shares of another is left out, since sums
/// of area must not count twice. The result does not depend on their order.
/// Errors, naming the files: kInvalidArgument when two are not of one job, or overlap without one
/// holding the other.
struct CombinedPartials {
  PartialInfo info;
  std::unique_ptr<ReservoirStore> store;
  std::vector<Partial> parts;         ///< What the store is made of.
  std::vector<std::string> left_out;  ///< Names of files that were not needed.
};
Result<CombinedPartials> CombinePartials(std::vector<Partial> partials, RunContext& context);

/// The job's result, to be gathered. Errors: kInvalidArgument naming the shares that are missing;
/// kEmptySurface.
Result<ScannedMesh> WholeOf(CombinedPartials combined);

}  // namespace strata
