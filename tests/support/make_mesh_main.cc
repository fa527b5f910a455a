// make_mesh: writes meshes of any size, for measurements.
#include <CLI/CLI.hpp>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>

#include "tests/support/make_mesh.h"

namespace {

using namespace strata;

struct Arguments {
  std::string format = "ply", out, scan;
  std::uint64_t triangles = 1000000, seed = 1;
  std::optional<std::uint64_t> shuffle, shuffle_faces;
};

int Write(test::ComputedMesh mesh, const Arguments& arguments) {
  if (arguments.shuffle) mesh = test::Shuffled(mesh, *arguments.shuffle);
  if (arguments.shuffle_faces) mesh = test::ShuffledFaces(mesh, *arguments.shuffle_faces);
  const auto written =
      test::WriteMesh(mesh, *test::MeshFormatNamed(arguments.format), arguments.out);
  if (!written) {
    std::fprintf(stderr, "make_mesh: %s\n", written.error().message.c_str());
    return 1;
  }
  std::printf("%llu vertices, %llu triangles\n", static_cast<unsigned long long>(mesh.vertices),
              static_cast<unsigned long long>(mesh.triangles));
  return 0;
}

int Tile(const Arguments& arguments) {
  const auto scan = test::ScanFromPly(arguments.scan);
  if (!scan || scan->triangles == 0) {
    std::fprintf(stderr, "make_mesh: %s\n",
                 scan ? "the scan is empty" : scan.error().message.c_str());
    return 1;
  }
  return Write(test::Tiled(*scan, arguments.triangles), arguments);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app{"Writes a mesh of any size straight to disk, in little memory."};
  app.require_subcommand(1);
  CLI::App* const sphere = app.add_subcommand("sphere", "a fractal sphere");
  CLI::App* const tiled = app.add_subcommand("tiled", "copies of a scan, side by side");
  sphere->add_option("--seed", arguments.seed, "which sphere")->capture_default_str();
  tiled->add_option("scan", arguments.scan, "binary PLY of triangles")->required();
  for (CLI::App* const kind : {sphere, tiled}) {
    kind->add_option("-n,--triangles", arguments.triangles, "how many, or about as many")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    kind->add_option("--format", arguments.format, "what to write")
        ->check(CLI::IsMember({"ply", "ply-ascii", "stl", "obj"}))
        ->capture_default_str();
    kind->add_option("--shuffle", arguments.shuffle, "permute the vertices by this seed");
    kind->add_option("--shuffle-faces", arguments.shuffle_faces,
                     "permute the triangles by this seed");
    kind->add_option("-o,--output", arguments.out, "file to write")->required();
  }
  CLI11_PARSE(app, argc, argv);
  return *sphere ? Write(test::FractalSphere(arguments.triangles, arguments.seed), arguments)
                 : Tile(arguments);
}
