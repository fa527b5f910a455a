// `strata merge --region`: one process's part of a merge.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "core/parcels.h"
#include "core/partial.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/scan_mesh.h"
#include "server/command_line.h"

namespace strata::server {

/// What a region came to.
struct RegionReport {
  bool was_there = false;  ///< The region, or all of them, had been done before.
  std::uint64_t cells = 0, samples = 0;
  std::uint32_t regions_done = 0;  ///< All: the output stands under its name.
};

/// Writes one region of the output of `command`, a drc folder, from all parts of the surface that
/// `scanned` describes, and publishes the output if the region was the last one missing. `mesh` is
/// the parts' digest of the mesh. Errors: as RunMerge; those of RegionFolder.
struct RegionJob {
  const SampleCommand& command;
  Region region;
  std::span<const Partial> parts;
};
Result<RegionReport> MergeRegion(const RegionJob& job, ScannedMesh scanned, RunContext& context);

/// The report as a summary for people.
std::string RegionText(const RegionJob& job, const RegionReport& report);

}  // namespace strata::server
