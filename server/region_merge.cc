#include "server/region_merge.h"

#include <cstdio>
#include <sstream>
#include <utility>

#include "io/region_folder.h"
#include "server/human_units.h"
#include "server/write_samples.h"

namespace strata::server {
namespace {

std::string HexOfMesh(const std::array<std::uint64_t, 4>& mesh) {
  std::string hex;
  for (const std::uint64_t word : mesh) {
    char digits[17];
    std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(word));
    hex += digits;
  }
  return hex;
}

Result<void> WriteRegion(const RegionJob& job, io::RegionFolder& folder, ScannedMesh scanned,
                         RunContext& context, RegionReport& report) {
  auto sampled = GatherRegion(std::move(scanned), job.parts, job.region,
                              OptionsForOutput(job.command), context);
  if (!sampled) return Forward(sampled);
  report.cells = sampled->stats.cells;
  report.samples = sampled->stats.survivors;
  context.SetStage(RunContext::Stage::kWrite);
  if (report.samples == 0) return folder.WriteNothing();
  auto writer = folder.Write(HeaderOf(job.command, *sampled), ResourcesOf(job.command, context));
  if (!writer) return Forward(writer);
  const auto bytes = WriteAll(*sampled, **writer, context);
  return bytes ? Result<void>() : Forward(bytes);
}

}  // namespace

Result<RegionReport> MergeRegion(const RegionJob& job, ScannedMesh scanned, RunContext& context) {
  io::SharedOutput output;
  output.path = job.command.output;
  output.header = HeaderOf(job.command, scanned.stats);
  output.tile_samples = job.command.tile_samples;
  output.mesh = HexOfMesh(job.parts.front().info.mesh);
  output.region = job.region;
  auto folder = io::RegionFolder::Open(output);
  if (!folder) return Forward(folder);
  RegionReport report;
  report.was_there = (*folder)->IsFinished() || (*folder)->IsRegionDone();
  Result<void> written;
  if (!report.was_there) {
    written = WriteRegion(job, **folder, std::move(scanned), context, report);
  }
  if (!written && written.error().code != ErrorCode::kIo) return Forward(written);
  const auto done = (*folder)->Commit();
  // What was in the way may have been another process with the same region, which was quicker.
  if (!written && !(done && *done == job.region.count)) return Forward(written);
  if (!done) return Forward(done);
  report.regions_done = *done;
  return report;
}

std::string RegionText(const RegionJob& job, const RegionReport& report) {
  std::uint64_t read = 0, size = 0;
  for (const Partial& part : job.parts) {
    read += part.file->bytes_read();
    size += part.file->size();
  }
  std::ostringstream out;
  out << "region     " << job.region.index << '/' << job.region.count << ": ";
  if (report.was_there) {
    out << "was there already\n";
  } else {
    out << Grouped(report.samples) << " samples of " << Grouped(report.cells) << " cells\n";
  }
  out << "read       " << Grouped(read) << " bytes; the parts have " << Grouped(size) << '\n'
      << "regions    ";
  if (report.regions_done < job.region.count) {
    out << report.regions_done << " of " << job.region.count << " done\n";
  } else {
    out << "all done: " << job.command.output << '\n';
  }
  return out.str();
}

}  // namespace strata::server
