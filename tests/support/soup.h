// Indexed meshes of a few ten thousand vertices as the bytes of a file, in every format.
#pragma once

#include <array>
#include <cstdint>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/make_mesh.h"
#include "tests/support/mesh_text.h"

namespace strata::test {

/// Vertices and polygons.
struct Soup {
  std::vector<std::array<float, 3>> vertices;
  std::vector<std::vector<std::uint64_t>> faces;
};

/// A fractal sphere of about `triangles`. With `polygons`, some are quads and some are wrong: too
/// few corners, or a vertex that does not exist.
enum class Order : std::uint8_t { kCoherent, kShuffledVertices, kAllShuffled };

inline Soup SphereSoup(std::uint64_t triangles, Order order, bool polygons) {
  ComputedMesh mesh = FractalSphere(triangles);
  if (order != Order::kCoherent) mesh = Shuffled(mesh, 11);
  if (order == Order::kAllShuffled) mesh = ShuffledFaces(mesh, 12);
  Soup soup;
  for (std::uint64_t i = 0; i < mesh.vertices; ++i) soup.vertices.push_back(mesh.vertex(i));
  for (std::uint64_t i = 0; i < mesh.triangles; ++i) {
    const auto [a, b, c] = mesh.triangle(i);
    if (polygons && i % 6 == 0) {
      const auto next = mesh.triangle(++i);
      soup.faces.push_back({a, b, next[2], c});
    } else {
      soup.faces.push_back({a, b, c});
    }
    if (polygons && i % 1000 == 3) soup.faces.push_back({a, b, mesh.vertices + i});
    if (polygons && i % 1000 == 5) soup.faces.push_back({a, b});
  }
  return soup;
}

inline std::string SoupPly(const Soup& soup, const std::string& format) {
  PlyPart vertices = PlyVertices({}), faces = PlyFaces({});
  for (const auto& [x, y, z] : soup.vertices) {
    vertices.rows.push_back({double{x}, double{y}, double{z}});
  }
  for (const auto& face : soup.faces) {
    std::vector<double> row{static_cast<double>(face.size())};
    for (const std::uint64_t i : face) row.push_back(static_cast<double>(i));
    faces.rows.push_back(std::move(row));
  }
  return MakePly(format, {vertices, faces});
}

inline std::string SoupObj(const Soup& soup) {
  std::ostringstream out;
  out.precision(9);
  for (const auto& [x, y, z] : soup.vertices) out << "v " << x << ' ' << y << ' ' << z << '\n';
  for (const auto& face : soup.faces) {
    out << 'f';
    for (const std::uint64_t i : face) out << ' ' << i + 1;
    out << '\n';
  }
  return out.str();
}

inline std::string SoupOff(const Soup& soup) {
  std::ostringstream out;
  out.precision(9);
  out << "OFF\n" << soup.vertices.size() << ' ' << soup.faces.size() << " 0\n";
  for (const auto& [x, y, z] : soup.vertices) out << x << ' ' << y << ' ' << z << '\n';
  for (const auto& face : soup.faces) {
    out << face.size();
    for (const std::uint64_t i : face) out << ' ' << i;
    out << '\n';
  }
  return out.str();
}

/// The bytes of `soup` as "ascii", "binary_little_endian", "binary_big_endian", "obj" or "off".
inline constexpr const char* kSoupFormats[] = {"ascii", "binary_little_endian", "binary_big_endian",
                                               "obj", "off"};
inline std::string SoupBytes(const Soup& soup, const std::string& format) {
  if (format == "obj") return SoupObj(soup);
  return format == "off" ? SoupOff(soup) : SoupPly(soup, format);
}

}  // namespace strata::test
