// Meshes as text, made on the spot.
#pragma once

#include <sstream>
#include <string>

namespace strata::test {

/// A square in the plane z = x / 10, n × n quads, as OBJ.
inline std::string SheetObj(int n) {
  std::ostringstream obj;
  for (int y = 0; y <= n; ++y) {
    for (int x = 0; x <= n; ++x) obj << "v " << x << ' ' << y << ' ' << x / 10.0 << '\n';
  }
  for (int y = 0; y < n; ++y) {
    for (int x = 0; x < n; ++x) {
      const int a = y * (n + 1) + x + 1;
      obj << "f " << a << ' ' << a + 1 << ' ' << a + n + 2 << ' ' << a + n + 1 << '\n';
    }
  }
  return obj.str();
}

/// The unit cube's surface, twelve triangles, as OBJ.
inline std::string CubeObj() {
  return "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
         "f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\n"
         "f 3 4 8\nf 3 8 7\nf 2 3 7\nf 2 7 6\nf 1 5 8\nf 1 8 4\n";
}

/// The same cube as ascii PLY.
inline std::string CubePly() {
  return "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
         "property float z\nelement face 12\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n"
         "3 0 2 1\n3 0 3 2\n3 4 5 6\n3 4 6 7\n3 0 1 5\n3 0 5 4\n"
         "3 2 3 7\n3 2 7 6\n3 1 2 6\n3 1 6 5\n3 0 4 7\n3 0 7 3\n";
}

/// One triangle of positive area and one whose corners coincide.
inline std::string OneGoodOneFlatObj() {
  return "v 0 0 0\nv 1 0 0\nv 0 1 0.25\nf 1 2 3\nf 1 2 2\n";
}

/// A single triangle without area.
inline std::string FlatObj() { return "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"; }

}  // namespace strata::test
