#include "server/write_samples.h"

#include "core/parcels.h"
#include "server/provenance.h"
#include "server/resources.h"

namespace strata::server {

SampleOptions OptionsForOutput(const SampleCommand& command) {
  SampleOptions options = command.options;
  if (command.format == io::SampleFormat::kVdb) options.attributes |= kCell;  // Its voxels.
  if (command.format == io::SampleFormat::kDraco) {  // It may become a folder of tiles.
    options.attributes |= kCell;
    options.parcel_cells = CellsPerParcel(command.tile_samples, options.min_distance);
  }
  return options;
}

SampleHeader HeaderOf(const SampleCommand& command, const SampleStats& stats) {
  SampleHeader header;
  header.attributes = command.options.attributes;
  header.edge = stats.lattice.edge;
  header.lattice_origin = stats.lattice.origin;
  header.position_error = command.position_error * stats.lattice.edge;
  header.provenance = Provenance(command.options, command.position_error, stats);
  header.surface = stats.bounds;
  return header;
}

SampleHeader HeaderOf(const SampleCommand& command, const SampledMesh& sampled) {
  SampleHeader header = HeaderOf(command, sampled.stats);
  header.count = sampled.stats.survivors;
  header.bounds = sampled.bounds;
  header.carried = sampled.carried;
  header.parcels = sampled.parcels;
  return header;
}

io::WriterResources ResourcesOf(const SampleCommand& command, RunContext& context) {
  io::WriterResources resources;
  resources.context = &context;
  resources.tile_samples = command.tile_samples;
  resources.tiles_in_zip = command.tiles_in_zip;
  resources.memory = &context.memory();
  resources.scratch = context.scratch();
  if (command.format == io::SampleFormat::kVdb) resources.vdb_program = VdbProgram();
  return resources;
}

Result<std::uint64_t> WriteAll(SampledMesh& sampled, SampleWriter& writer, RunContext& context,
                               const std::function<void(const SampleColumns&)>& visit) {
  SampleColumns samples;
  for (std::uint64_t written = 0;;) {
    context.SetProgress(written, sampled.stats.survivors);
    if (context.cancelled()) return Cancelled();
    const auto more = sampled.samples->Next(samples);
    if (!more) return Forward(more);
    if (!*more) break;
    if (auto taken = writer.Write(samples); !taken) return Forward(taken);
    if (visit) visit(samples);
    written += samples.size();
  }
  sampled.samples.reset();
  return writer.Finish();
}

}  // namespace strata::server
