// Time and memory of reading or sampling a mesh whose vertices have a budget:
// far_vertices MESH BUDGET_BYTES SCRATCH_DIR info|sample [RESOLUTION]. Budget 0 is none.
#include <sys/resource.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "core/sample_mesh.h"
#include "core/summarize_mesh.h"
#include "io/open_mesh.h"

namespace {

using namespace strata;

std::string Digest(MeshReader& reader, const std::string& job, std::uint32_t resolution) {
  RunContext context;
  char text[160];
  if (job == "info") {
    const auto summary = SummarizeMesh(reader, context);
    if (!summary) return summary.error().message;
    std::snprintf(text, sizeof text, "area %.17g of %llu triangles", summary->area,
                  static_cast<unsigned long long>(summary->surface_triangles));
    return text;
  }
  SampleOptions options;
  options.lattice = Resolution{resolution};
  const auto result = SampleMesh(reader, options, context);
  if (!result) return result.error().message;
  std::snprintf(text, sizeof text, "surface %s, %llu samples, %d passes",
                result->stats.surface_hash.c_str(),
                static_cast<unsigned long long>(result->stats.survivors), result->stats.passes);
  return text;
}

double Seconds(const timeval& t) {
  return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) return 2;
  const auto start = std::chrono::steady_clock::now();
  auto scratch = ScratchFolder::Open(argv[3]);
  if (!scratch) return 1;
  io::OpenOptions options;
  if (const std::uint64_t budget = std::strtoull(argv[2], nullptr, 10)) {
    options.vertex_budget = budget;
    options.scratch = scratch->get();
  }
  auto reader = io::OpenMesh(argv[1], options);
  if (!reader) {
    std::printf("%s\n", reader.error().message.c_str());
    return 1;
  }
  const auto resolution = static_cast<std::uint32_t>(argc > 5 ? std::atoi(argv[5]) : 512);
  const std::string digest = Digest(**reader, argv[4], resolution);
  const std::chrono::duration<double> wall = std::chrono::steady_clock::now() - start;
  rusage use{};
  getrusage(RUSAGE_SELF, &use);
  std::printf("%s: wall %.2f s, user %.2f s, system %.2f s, peak %ld MiB; %s\n", argv[4],
              wall.count(), Seconds(use.ru_utime), Seconds(use.ru_stime), use.ru_maxrss / 1024,
              digest.c_str());
}
