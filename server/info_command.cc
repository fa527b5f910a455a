#include "server/info_command.h"

#include <string>
#include <vector>

#include "core/summarize_mesh.h"
#include "io/atomic_file.h"
#include "io/open_mesh.h"
#include "server/attribute_ranges.h"
#include "server/progress_bar.h"
#include "server/resources.h"
#include "server/summary_json.h"

namespace strata::server {
namespace {

// Two readers of a file give the ranges together. Standard input can be read once only.
Result<std::vector<AttributeRange>> RangesOf(const InfoCommand& command, MeshReader& reader,
                                             RunContext& context) {
  std::vector<AttributeRange> ranges;
  for (const MeshAttribute& attribute : reader.attributes()) {
    ranges.push_back({attribute, {}, {}, ""});
  }
  if (ranges.empty() || command.input == "-") return ranges;
  const auto triangles = io::OpenMesh(command.input, OpenWithin(context, command.assimp));
  if (!triangles) return Forward(triangles);
  auto found = FindRanges(**triangles, reader, context);
  if (found || found.error().code != ErrorCode::kCorruptInput) return found;
  // The surface is sound: what is wrong with values beside it is part of the answer.
  for (AttributeRange& range : ranges) range.fault = found.error().message;
  return ranges;
}

// What an attribute needs from elsewhere and is not there.
void NoteAbsent(MeshReader& reader, std::vector<AttributeRange>& ranges, RunContext& context) {
  for (std::size_t k = 0; k < ranges.size(); ++k) {
    if (!ranges[k].fault.empty()) continue;
    const auto checked = reader.CheckAttribute(k, CheckDepth::kHeads, context);
    if (!checked) ranges[k].fault = checked.error().message;
  }
}

}  // namespace

Result<void> RunInfo(const InfoCommand& command, RunContext& context) {
  ProgressBar bar(context, true);
  const auto scratch = OpenScratch({});
  if (!scratch) return Forward(scratch);
  context.SetScratch(scratch->get());
  const auto reader = io::OpenMesh(command.input, OpenWithin(context, command.assimp));
  if (!reader) return Forward(reader);
  const auto summary = SummarizeMesh(**reader, context);
  if (!summary) return Forward(summary);
  auto attributes = RangesOf(command, **reader, context);
  if (!attributes) return Forward(attributes);
  NoteAbsent(**reader, *attributes, context);
  const std::vector<MeshTexture> textures = (*reader)->InspectTextures(context);
  bar.Stop();
  auto out = io::AtomicFile::Open("-");
  if (!out) return Forward(out);
  const MeshInfo& info = (*reader)->info();
  auto written = (*out)->Write(command.json ? InfoJson(info, *summary, *attributes, textures)
                                            : InfoText(info, *summary, *attributes, textures));
  if (!written) return written;
  if (auto finished = (*out)->Finish(); !finished) return Forward(finished);
  return {};
}

}  // namespace strata::server
