// Arbitrary bytes as a polygon: on a small flat grid, on a small grid in space, or any doubles.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <map>
#include <utility>
#include <vector>

#include "io/triangulate.h"
#include "tests/fuzz/drain.h"

namespace {

using strata::Vec3;
using strata::test::Require;
using Triangles = std::vector<std::array<std::uint32_t, 3>>;

std::vector<Vec3> Polygon(const std::uint8_t* data, std::size_t size) {
  std::vector<Vec3> corners;
  if (size == 0) return corners;
  const int mode = data[0] % 3;
  ++data, --size;
  const std::size_t step = mode == 0 ? 2 : mode == 1 ? 3 : 3 * sizeof(double);
  for (; size >= step; data += step, size -= step) {
    Vec3 p;
    if (mode == 2) {
      double xyz[3];
      std::memcpy(xyz, data, sizeof xyz);
      p = {xyz[0], xyz[1], xyz[2]};
    } else {
      p = {double(static_cast<std::int8_t>(data[0])), double(static_cast<std::int8_t>(data[1])),
           mode == 0 ? 0.0 : double(static_cast<std::int8_t>(data[2]))};
    }
    corners.push_back(p);
  }
  return corners;
}

bool AllFinite(const std::vector<Vec3>& corners) {
  return std::all_of(corners.begin(), corners.end(), [](Vec3 p) {
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
  });
}

// The triangles' edges must cancel to the outline, whatever the polygon.
void CheckOutline(const Triangles& triangles, std::size_t n) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (const auto& t : triangles) {
    for (std::size_t k = 0; k < 3; ++k) {
      Require(t[k] < n);
      ++edges[{t[k], t[(k + 1) % 3]}];
      --edges[{t[(k + 1) % 3], t[k]}];
    }
  }
  for (const auto& [edge, count] : edges) {
    if ((edge.first + 1) % n == edge.second) {
      Require(count == 1);
    } else if ((edge.second + 1) % n != edge.first) {
      Require(count == 0);
    }
  }
}

std::vector<std::array<double, 9>> Canonical(const std::vector<Vec3>& corners,
                                             const Triangles& triangles) {
  std::vector<std::array<double, 9>> result;
  for (const auto& t : triangles) {
    std::array<std::array<double, 3>, 3> c;
    for (std::size_t k = 0; k < 3; ++k) {
      // Adding zero makes the two zeros one.
      c[k] = {corners[t[k]].x + 0.0, corners[t[k]].y + 0.0, corners[t[k]].z + 0.0};
    }
    // The least of the three rotations, as corners may coincide.
    auto least = c;
    for (int k = 0; k < 2; ++k) {
      std::rotate(c.begin(), c.begin() + 1, c.end());
      least = std::min(least, c);
    }
    c = least;
    result.push_back(
        {c[0][0], c[0][1], c[0][2], c[1][0], c[1][1], c[1][2], c[2][0], c[2][1], c[2][2]});
  }
  std::sort(result.begin(), result.end());
  return result;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<Vec3> corners = Polygon(data, size);
  const std::size_t n = corners.size();
  Triangles triangles;
  strata::io::TriangulatePolygon(corners, triangles);
  Require(triangles.size() == (n < 3 ? 0 : n - 2));
  if (n < 3) return 0;
  CheckOutline(triangles, n);
  if (!AllFinite(corners)) return 0;
  const auto expected = Canonical(corners, triangles);
  std::rotate(corners.begin(), corners.begin() + static_cast<std::ptrdiff_t>(1 + size % (n - 1)),
              corners.end());
  triangles.clear();
  strata::io::TriangulatePolygon(corners, triangles);
  Require(Canonical(corners, triangles) == expected);
  return 0;
}
