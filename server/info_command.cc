#include "server/info_command.h"

#include "core/summarize_mesh.h"
#include "io/atomic_file.h"
#include "io/open_mesh.h"
#include "server/progress_bar.h"
#include "server/resources.h"
#include "server/summary_json.h"

namespace strata::server {

Result<void> RunInfo(const InfoCommand& command, RunContext& context) {
  ProgressBar bar(context, true);
  const auto scratch = OpenScratch({});
  if (!scratch) return Forward(scratch);
  context.SetScratch(scratch->get());
  const auto reader = io::OpenMesh(command.input, OpenWithin(context));
  if (!reader) return Forward(reader);
  const auto summary = SummarizeMesh(**reader, context);
  if (!summary) return Forward(summary);
  bar.Stop();
  auto out = io::AtomicFile::Open("-");
  if (!out) return Forward(out);
  const MeshInfo& info = (*reader)->info();
  auto written = (*out)->Write(command.json ? InfoJson(info, *summary) : InfoText(info, *summary));
  if (!written) return written;
  if (auto finished = (*out)->Finish(); !finished) return Forward(finished);
  return {};
}

}  // namespace strata::server
