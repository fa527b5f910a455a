#include "server/option_table.h"

#include <algorithm>
#include <array>
#include <iterator>
#include <sstream>

#include "server/exit_codes.h"

namespace strata::server {
namespace {

constexpr const char* kWhere = "Where (at most one of these)";
constexpr const char* kHow = "How";
constexpr const char* kWhat = "What comes out";
constexpr const char* kRun = "How it runs (none of these changes a sample)";

constexpr std::array<OptionRow, 22> kOptionRows = {{
    {"--resolution", "N", kWhere,
     "Cells along the longest side of the bounding box.\n"
     "1 to 536870912; default 128.",
     &RawSample::resolution},
    {"--voxel-size", "E", kWhere,
     "Edge of a cell in world units; the lattice is fixed in the world,\n"
     "so that neighbouring models share it. 1e-60 to 1e60.",
     &RawSample::voxel_size},
    {"--height", "H", kWhere,
     "Height of the paper's octree: edge 2R / 2^(H-1), R the radius of\n"
     "the minimum enclosing ball. 1 to 30.",
     &RawSample::height},
    {"--method", "stratified|uniform", kHow,
     "stratified: one sample per occupied cell, then the minimum\n"
     "distance; uniform: independent samples, uniform by area.\n"
     "Default stratified.",
     &RawSample::method},
    {"--count", "N", kHow,
     "Of --method uniform, how many samples, 1 to 1099511627776. Default:\n"
     "as many as stratified keeps with the same options. Excludes\n"
     "--lambda, --min-distance and --integrator, which decide that.",
     &RawSample::count},
    {"--lambda", "L", kHow,
     "How strongly samples keep to the centre of their cell: density\n"
     "exp(-L d), d in edges; 0 = uniform. 0 to 500; default 5.",
     &RawSample::lambda},
    {"--min-distance", "M", kHow,
     "Smallest distance between two samples, as a fraction of the edge;\n"
     "0 = off. 0 to 4; default 0.5.",
     &RawSample::min_distance},
    {"--seed", "S", kHow,
     "Same surface, options and seed: same samples.\n"
     "0 to 18446744073709551615; default 0.",
     &RawSample::seed},
    {"--integrator", "exact|subdivide", kHow,
     "exact: the law itself; subdivide: the paper's own approximation.\n"
     "Default exact.",
     &RawSample::integrator},
    {"-o,--output", "OUTPUT", kWhat,
     "The file to write; - is standard output. Needed. It appears whole\n"
     "or not at all.",
     &RawSample::output},
    {"--format", "drc|ply|xyz|npz|csv|glb|vdb", kWhat,
     "drc (Draco), ply (binary), xyz (text), npz (NumPy), csv, glb\n"
     "(binary glTF) or vdb (OpenVDB points). Default: from OUTPUT's\n"
     "suffix.",
     &RawSample::format},
    {"--attributes", "LIST", kWhat,
     "What stands beside each position, with commas between: any of\n"
     "normal, triangle, barycentric, cell, area, weight; and of what\n"
     "the mesh carries (strata info lists it), by name or as color, uv,\n"
     "material, group, object, texture. Or all, or none. Default normal.",
     &RawSample::attributes},
    {"--normals", "face|vertex", kWhat,
     "face: of the triangle; vertex: interpolated from the mesh's own,\n"
     "of length one. Default face.",
     &RawSample::normals},
    {"--position-error", "F", kWhat,
     "How far drc and vdb may move a sample, as a fraction of the edge.\n"
     "1e-9 to 1; default 0.01.",
     &RawSample::position_error},
    {"--tile-samples", "N", kWhat,
     "A drc of more samples becomes a folder OUTPUT of tiles of at most\n"
     "N samples, with a tileset.json. 1 to 536870911; default 4000000.",
     &RawSample::tile_samples},
    {"--picture", "FILE.png", kWhat, "Also draw the samples as a PNG.", &RawSample::picture},
    {"--summary", "FILE", kWhat,
     "Also write counts, areas, seconds and bytes as JSON; - is standard\n"
     "output.",
     &RawSample::summary},
    {"--memory", "SIZE", kRun,
     "How much memory to use: bytes, or a number with K, M, G or T\n"
     "(powers of 1024). What does not fit goes to scratch space. At\n"
     "least 64M; default half of what this process may use.",
     &RawSample::memory},
    {"--scratch", "DIR", kRun,
     "Where to put what does not fit memory while the job runs.\n"
     "Default the system's directory for temporary files.",
     &RawSample::scratch},
    {"--threads", "T", kRun, "0 to 1024; default 0 = all the processors this process may use.",
     &RawSample::threads},
    {"--simd", "TARGET", kRun,
     "Vector instructions: auto, or the name of a set this processor\n"
     "has (a wrong name lists them). Default auto.",
     &RawSample::simd},
    {"--batch-size", "B", kRun, "Triangles a worker takes at a time. 1 to 1048576; default 2048.",
     &RawSample::batch_size},
}};

constexpr std::array<FlagRow, 4> kFlagRows = {{
    {"--strict", kHow, "A triangle that would be skipped is an error instead.", &RawSample::strict},
    {"--assimp", kHow,
     "Let formats that Strata does not read itself (FBX, COLLADA, 3DS, ...)\n"
     "be read by assimp, in a process of its own that is shut in.",
     &RawSample::assimp},
    {"--resume", kRun,
     "Go on from where the same job was killed, if --scratch still has\n"
     "what it left; and leave that again, should this one fail.",
     &RawSample::resume},
    {"--quiet", kRun, "No progress bar and no summary; errors only.", &RawSample::quiet},
}};

}  // namespace

std::span<const OptionRow> SampleOptionRows() { return kOptionRows; }
std::span<const FlagRow> SampleFlagRows() { return kFlagRows; }

bool Takes(Subcommand command, std::string_view names) {
  if (command == Subcommand::kSample) return true;
  // Not of shares, nor of partials, which know no mesh.
  if (names == "--method" || names == "--count" || names == "--normals") return false;
  // What decides the reservoirs, and what decides the rest.
  constexpr std::string_view kOfScan[] = {
      "--resolution", "--voxel-size", "--height", "--lambda", "--seed",  "--integrator",
      "--simd",       "--batch-size", "--strict", "--resume", "--assimp"};
  constexpr std::string_view kOfMerge[] = {"--min-distance", "--format",  "--position-error",
                                           "--tile-samples", "--picture", "--summary"};
  const bool of_scan = std::ranges::find(kOfScan, names) != std::end(kOfScan);
  const bool of_merge = std::ranges::find(kOfMerge, names) != std::end(kOfMerge);
  return command == Subcommand::kScan ? !of_merge : !of_scan;
}

std::string ExamplesText() {
  return "Examples:\n"
         "  strata sample model.ply -o model.drc\n"
         "      one sample per cell, 128 cells along the longest side\n"
         "  strata sample scan.obj.gz -o points.npz --voxel-size 0.02 --attributes normal,area\n"
         "      cells of 0.02 world units; NumPy arrays with normals and areas\n"
         "  zcat big.ply.gz | strata sample - -o - --format ply --summary run.json > points.ply\n"
         "      in a pipe\n"
         "  strata scan big.ply --resolution 4096 --share 3/16 -o part-3.run\n"
         "  strata merge part-*.run -o big.drc\n"
         "      shared among machines\n";
}

std::string ExitCodesText() {
  std::ostringstream out;
  out << "Exit codes:\n    0  done\n";
  for (const ExitCode& row : kExitCodes) {
    out.width(5);
    out << row.exit_status << "  " << row.meaning << '\n';
  }
  return out.str();
}

}  // namespace strata::server
