// Samples a mesh with CGAL: `cgal_sample random MESH POINTS`, or `cgal_sample grid MESH POINTS
// EDGE`, which then keeps one point in each cell of edge EDGE. Prints one line of JSON: points, and
// the CPU seconds of reading and sampling.
#include <CGAL/Polygon_mesh_processing/distance.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/grid_simplify_point_set.h>

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace {

using Kernel = CGAL::Simple_cartesian<double>;
using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;

double CpuSeconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

}  // namespace

int main(int argc, char** argv) {
  const bool grid = argc == 5 && std::string(argv[1]) == "grid";
  if (!grid && !(argc == 4 && std::string(argv[1]) == "random")) return 2;
  const double start = CpuSeconds();
  Mesh mesh;
  std::ifstream in(argv[2], std::ios::binary);
  if (!CGAL::IO::read_PLY(in, mesh)) {
    std::fprintf(stderr, "%s: CGAL cannot read it\n", argv[2]);
    return 1;
  }
  const double read = CpuSeconds();
  namespace parameters = CGAL::parameters;
  std::vector<Kernel::Point_3> points;
  CGAL::Polygon_mesh_processing::sample_triangle_mesh(
      mesh, std::back_inserter(points),
      parameters::use_random_uniform_sampling(true)
          .number_of_points_on_faces(std::strtoul(argv[3], nullptr, 10))
          .do_sample_vertices(false)
          .do_sample_edges(false));
  if (grid) {
    points.erase(CGAL::grid_simplify_point_set(points, std::strtod(argv[4], nullptr)),
                 points.end());
  }
  std::printf("{\"points\": %zu, \"read_cpu\": %g, \"sample_cpu\": %g}\n", points.size(),
              read - start, CpuSeconds() - read);
}
