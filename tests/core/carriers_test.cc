// Promise 3, its last words: the samples do not depend on the file format that carried the numbers.
#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cstdio>
#include <fstream>
#include <map>
#include <string>

#include "core/sample_mesh.h"
#include "io/open_mesh.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/samples_equal.h"
#include "tests/support/scans.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

// Vertices that are floats, each once, and triangles of indices.
struct IndexedMesh {
  std::vector<std::array<float, 3>> vertices;
  std::vector<std::array<std::uint32_t, 3>> faces;
};

IndexedMesh Indexed(const Triangles& mesh) {
  IndexedMesh out;
  std::map<std::array<float, 3>, std::uint32_t> numbers;
  for (const Triangle& t : mesh) {
    std::array<std::uint32_t, 3> face{};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::array<float, 3> v{static_cast<float>(t[k].x), static_cast<float>(t[k].y),
                                   static_cast<float>(t[k].z)};
      const auto [at, fresh] = numbers.emplace(v, static_cast<std::uint32_t>(out.vertices.size()));
      if (fresh) out.vertices.push_back(v);
      face[k] = at->second;
    }
    out.faces.push_back(face);
  }
  return out;
}

// A float's exact value in decimal.
std::string Exactly(float v) {
  char text[64];
  std::snprintf(text, sizeof text, "%.17g", static_cast<double>(v));
  return text;
}
std::string Line(const std::array<float, 3>& v) {
  return Exactly(v[0]) + " " + Exactly(v[1]) + " " + Exactly(v[2]) + "\n";
}

template <class T>
void AppendBytes(std::string& out, T value, bool big_endian = false) {
  char bytes[sizeof(T)];
  std::memcpy(bytes, &value, sizeof(T));
  if (big_endian) std::reverse(bytes, bytes + sizeof(T));
  out.append(bytes, sizeof(T));
}

std::string PlyHeader(const IndexedMesh& m, const char* format, const char* real) {
  std::string h = std::string("ply\nformat ") + format + " 1.0\nelement vertex " +
                  std::to_string(m.vertices.size()) + "\n";
  for (const char* axis : {"x", "y", "z"}) h += std::string("property ") + real + " " + axis + "\n";
  return h + "element face " + std::to_string(m.faces.size()) +
         "\nproperty list uchar int vertex_indices\nend_header\n";
}

template <class Real>
std::string BinaryPly(const IndexedMesh& m, bool big_endian) {
  std::string out = PlyHeader(m, big_endian ? "binary_big_endian" : "binary_little_endian",
                              sizeof(Real) == 8 ? "double" : "float");
  for (const auto& v : m.vertices) {
    for (const float c : v) AppendBytes(out, static_cast<Real>(c), big_endian);
  }
  for (const auto& f : m.faces) {
    out.push_back(3);
    for (const std::uint32_t i : f) AppendBytes(out, i, big_endian);
  }
  return out;
}

std::string AsciiPly(const IndexedMesh& m) {
  std::string out = PlyHeader(m, "ascii", "float");
  for (const auto& v : m.vertices) out += Line(v);
  for (const auto& f : m.faces) {
    out += "3 " + std::to_string(f[0]) + " " + std::to_string(f[1]) + " " + std::to_string(f[2]) +
           "\n";
  }
  return out;
}

std::string Obj(const IndexedMesh& m) {
  std::string out;
  for (const auto& v : m.vertices) out += "v " + Line(v);
  for (const auto& f : m.faces) {
    out += "f " + std::to_string(f[0] + 1) + " " + std::to_string(f[1] + 1) + " " +
           std::to_string(f[2] + 1) + "\n";
  }
  return out;
}

std::string Off(const IndexedMesh& m) {
  std::string out =
      "OFF\n" + std::to_string(m.vertices.size()) + " " + std::to_string(m.faces.size()) + " 0\n";
  for (const auto& v : m.vertices) out += Line(v);
  for (const auto& f : m.faces) {
    out += "3 " + std::to_string(f[0]) + " " + std::to_string(f[1]) + " " + std::to_string(f[2]) +
           "\n";
  }
  return out;
}

std::string BinaryStl(const IndexedMesh& m) {
  std::string out(80, ' ');
  AppendBytes(out, static_cast<std::uint32_t>(m.faces.size()));
  for (const auto& f : m.faces) {
    out.append(12, '\0');
    for (const std::uint32_t i : f) {
      for (const float c : m.vertices[i]) AppendBytes(out, c);
    }
    out.append(2, '\0');
  }
  return out;
}

std::string AsciiStl(const IndexedMesh& m) {
  std::string out = "solid mesh\n";
  for (const auto& f : m.faces) {
    out += "facet normal 0 0 0\nouter loop\n";
    for (const std::uint32_t i : f) out += "vertex " + Line(m.vertices[i]);
    out += "endloop\nendfacet\n";
  }
  return out + "endsolid mesh\n";
}

Result<SampleResult> SampleFile(const std::string& path, const SampleOptions& options) {
  auto reader = io::OpenMesh(path);
  if (!reader) return Forward(reader);
  RunContext context;
  return SampleMesh(**reader, options, context);
}

void ExpectSameFromEveryFormat(const Triangles& mesh) {
  const IndexedMesh m = Indexed(mesh);
  const std::vector<std::pair<std::string, std::string>> files = {
      {"little.ply", BinaryPly<float>(m, false)},
      {"big.ply", BinaryPly<float>(m, true)},
      {"double.ply", BinaryPly<double>(m, false)},
      {"ascii.ply", AsciiPly(m)},
      {"binary.stl", BinaryStl(m)},
      {"ascii.stl", AsciiStl(m)},
      {"mesh.obj", Obj(m)},
      {"mesh.off", Off(m)}};
  const TempFolder folder;
  for (const auto& [name, bytes] : files) std::ofstream(folder / name, std::ios::binary) << bytes;
  for (const LatticeSpec& lattice :
       {LatticeSpec(Resolution{50}), LatticeSpec(VoxelSize{0.05}), LatticeSpec(Height{6})}) {
    SampleOptions options;
    options.lattice = lattice;
    options.attributes = kAllAttributes;
    const auto expected = SampleFile(folder / files[0].first, options);
    ASSERT_TRUE(expected) << expected.error().message;
    for (const auto& [name, bytes] : files) {
      const auto result = SampleFile(folder / name, options);
      ASSERT_TRUE(result) << name << ": " << result.error().message;
      EXPECT_TRUE(SameSamples(expected->samples, result->samples)) << name;
      EXPECT_TRUE(SameStats(expected->stats, result->stats)) << name;
      EXPECT_TRUE(SameColumn(expected->samples.barycentric, result->samples.barycentric, "weights"))
          << name;
    }
  }
}

TEST(Carriers, Promise3SamplesDoNotDependOnTheFileFormat) {
  TestRandom random(46);
  Triangles mesh;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 at = random.InBox({-1, -1, -1}, {1, 1, 1});
    Triangle t;
    for (Vec3& c : t) c = at + random.Direction() * random.LogIn(0.001, 0.5);
    mesh.push_back(t);
  }
  ExpectSameFromEveryFormat(mesh);
}

TEST(Carriers, Promise3SamplesOfAScanDoNotDependOnTheFileFormat) {
  STRATA_SCAN_OR_SKIP(path, "dragon_vrip_res4.ply.gz");
  const auto reader = OpenScan(path);
  ASSERT_NE(reader, nullptr);
  ExpectSameFromEveryFormat(ReadTriangles(*reader));
}

}  // namespace
}  // namespace strata::test
