#include "io/ply_reader.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/compress.h"
#include "tests/support/failing_source.h"
#include "tests/support/mesh_text.h"
#include "tests/support/read_mesh.h"

namespace strata::io {
namespace {

using test::kPlyFormats;
using test::MakePly;
using test::PlyFaces;
using test::PlyPart;
using test::PlyVertices;
using test::ReadWhole;
using test::WholeMesh;

Result<WholeMesh> Read(const std::string& bytes, std::size_t batch_size = 64) {
  return ReadWhole(OpenPly(MemorySource(bytes, "test.ply"), {}), batch_size);
}

WholeMesh MustRead(const std::string& bytes, std::size_t batch_size = 64) {
  auto mesh = Read(bytes, batch_size);
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? *mesh : WholeMesh{};
}

void ExpectError(const std::string& bytes, ErrorCode code, const std::string& part) {
  auto mesh = Read(bytes);
  ASSERT_FALSE(mesh) << bytes;
  EXPECT_EQ(mesh.error().code, code) << mesh.error().message;
  EXPECT_NE(mesh.error().message.find(part), std::string::npos) << mesh.error().message;
  EXPECT_TRUE(mesh.error().message.starts_with("test.ply: ")) << mesh.error().message;
}

using Triangles = std::vector<std::array<Vec3, 3>>;
const Vec3 kA{0, 0, 0}, kB{1, 0, 0}, kC{0, 1, 0}, kD{0, 0, 1}, kE{1, 1, 0.5};
const PlyPart kVertices = PlyVertices({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 0.5}});
const Triangles kTwo = {{kA, kB, kC}, {kB, kE, kD}};

TEST(PlyReader, ReadsTrianglesInEveryEncodingAndBatchSize) {
  for (const std::string format : kPlyFormats) {
    const std::string bytes = MakePly(format, {kVertices, PlyFaces({{0, 1, 2}, {1, 4, 3}})});
    for (const std::size_t batch : {1, 2, 3, 64}) {
      const WholeMesh mesh = MustRead(bytes, batch);
      EXPECT_EQ(mesh.triangles, kTwo) << format << " " << batch;
      EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1}));
      EXPECT_EQ(mesh.counts.vertices, 5u);
      EXPECT_EQ(mesh.counts.faces, 2u);
      EXPECT_EQ(mesh.counts.triangles, 2u);
      EXPECT_EQ(mesh.info.format, "ply");
      EXPECT_EQ(mesh.info.encoding, format);
      EXPECT_EQ(mesh.info.compression, "none");
    }
  }
}

TEST(PlyReader, KnowsTheOldAndTheNewTypeNames) {
  for (const std::string type :
       {"char", "uchar", "short", "ushort", "int", "uint", "float", "double", "int8", "uint8",
        "int16", "uint16", "int32", "uint32", "float32", "float64"}) {
    const PlyPart vertices{
        "vertex", {type + " x", type + " y", type + " z"}, {{0, 0, 0}, {100, 0, 1}, {0, 127, 2}}};
    for (const std::string format : kPlyFormats) {
      const WholeMesh mesh = MustRead(MakePly(format, {vertices, PlyFaces({{0, 1, 2}})}));
      const Triangles expected = {{Vec3{0, 0, 0}, Vec3{100, 0, 1}, Vec3{0, 127, 2}}};
      EXPECT_EQ(mesh.triangles, expected) << type << " " << format;
    }
  }
}

TEST(PlyReader, TakesListsOfEveryIntegerType) {
  for (const std::string count : {"char", "uchar", "short", "ushort", "int", "uint"}) {
    for (const std::string index : {"char", "uchar", "short", "ushort", "int", "uint"}) {
      PlyPart faces = PlyFaces({{0, 1, 2}, {1, 4, 3}});
      faces.properties = {"list " + count + " " + index + " vertex_index"};
      for (const std::string format : kPlyFormats) {
        EXPECT_EQ(MustRead(MakePly(format, {kVertices, faces})).triangles, kTwo)
            << format << " " << faces.properties[0];
      }
    }
  }
}

TEST(PlyReader, TakesPropertiesInAnyOrderAndPassesOverOthers) {
  const PlyPart vertices{
      "vertex",
      {"uchar red", "float z", "list uchar short ring", "double y", "list uchar float none",
       "float x", "short tail"},
      {{9, 0, 2, 1, 1, 0, 0, 0, -1}, {9, 0, 0, 0, 1, 5, 1, -1}, {9, 0, 3, 1, 2, 3, 1, 0, 0, -1}}};
  PlyPart faces{"face",
                {"float quality", "list uchar float texcoord", "list uchar int vertex_indices",
                 "list int uchar more", "uchar red"},
                {{0.5, 2, 0.25, 0.75, 3, 0, 1, 2, 1, 7, 8}}};
  const Triangles expected = {{kA, kB, kC}};
  for (const std::string format : kPlyFormats) {
    const WholeMesh mesh = MustRead(MakePly(format, {vertices, faces}));
    EXPECT_EQ(mesh.triangles, expected) << format;
    EXPECT_EQ(mesh.vertices, (std::vector<Vec3>{kA, kB, kC}));
  }
}

TEST(PlyReader, ReadsFacesWithFixedPropertiesAroundTheList) {
  const PlyPart faces{"face",
                      {"uchar a", "double b", "list uchar uint vertex_indices", "short c"},
                      {{1, 2, 3, 0, 1, 2, 4}, {1, 2, 3, 1, 4, 3, 5}}};
  for (const std::string format : kPlyFormats) {
    for (const std::size_t batch : {1, 64}) {
      EXPECT_EQ(MustRead(MakePly(format, {kVertices, faces}), batch).triangles, kTwo) << format;
    }
  }
}

TEST(PlyReader, ReadsVerticesWiderThanItsView) {
  PlyPart vertices = kVertices;
  for (int i = 0; i < 700; ++i) {
    vertices.properties.push_back("double extra" + std::to_string(i));
    for (auto& row : vertices.rows) row.push_back(i);
  }
  vertices.properties[2].swap(vertices.properties[702]);
  for (auto& row : vertices.rows) std::swap(row[2], row[702]);
  for (const std::string format : kPlyFormats) {
    const PlyPart faces = PlyFaces({{0, 1, 2}, {1, 4, 3}});
    EXPECT_EQ(MustRead(MakePly(format, {vertices, faces})).triangles, kTwo) << format;
  }
}

TEST(PlyReader, TakesElementsInAnyOrder) {
  const PlyPart faces = PlyFaces({{0, 1, 2}, {1, 4, 3}});
  const PlyPart fixed{"edge", {"int a", "double b"}, {{1, 2}, {3, 4}}};
  const PlyPart lists{"material", {"list uchar int l", "uchar u"}, {{2, 5, 6, 7}, {0, 8}}};
  const PlyPart nothing{"nothing", {}, {}};
  for (const std::string format : kPlyFormats) {
    for (const auto& parts :
         std::vector<std::vector<PlyPart>>{{faces, kVertices},
                                           {fixed, kVertices, lists, faces, fixed},
                                           {lists, faces, fixed, kVertices, nothing, lists},
                                           {kVertices, fixed, nothing, faces}}) {
      std::vector<PlyPart> named = parts;  // Element names must differ.
      for (std::size_t i = 0; i < named.size(); ++i) {
        if (named[i].name == "edge" || named[i].name == "material") {
          named[i].name += std::to_string(i);
        }
      }
      const std::string bytes = MakePly(format, named);
      for (const std::string& packed : {bytes, test::Gzip(bytes), test::Zstd(bytes)}) {
        for (const std::size_t batch : {1, 64}) {
          const WholeMesh mesh = MustRead(packed, batch);
          EXPECT_EQ(mesh.triangles, kTwo) << bytes;
          EXPECT_EQ(mesh.vertices.size(), 5u);
        }
      }
    }
  }
}

TEST(PlyReader, UnrollsTriangleStripsAlternatingTheWinding) {
  const PlyPart strips{"tristrips",
                       {"char before", "list int int vertex_indices", "char after"},
                       {{0, 9, 0, 1, 2, 4, -1, 1, 4, 3, -1, 0}, {0, 0, 0}, {0, 3, 2, 1, 0, 0}}};
  const Triangles expected = {{kA, kB, kC}, {kC, kB, kE}, {kB, kE, kD}, {kC, kB, kA}};
  for (const std::string format : kPlyFormats) {
    for (const std::size_t batch : {1, 2, 64}) {
      const WholeMesh mesh = MustRead(MakePly(format, {kVertices, strips}), batch);
      EXPECT_EQ(mesh.triangles, expected) << format << " " << batch;
      EXPECT_EQ(mesh.counts.faces, 4u);
    }
  }
}

TEST(PlyReader, CountsWhatIsWrongInStrips) {
  // A strip of two corners, one of one, and one whose third corner does not exist.
  const PlyPart strips{
      "tristrips", {"list int int vertex_indices"}, {{12, 0, 1, -1, -1, 2, -1, 0, 1, 9, 2, 3, -1}}};
  for (const std::string format : kPlyFormats) {
    for (const std::size_t batch : {1, 64}) {
      const WholeMesh mesh = MustRead(MakePly(format, {kVertices, strips}), batch);
      EXPECT_EQ(mesh.triangles.size(), 0u);
      EXPECT_EQ(mesh.skipped(SkipReason::kTooFewCorners), 2u);
      EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 3u);
      EXPECT_EQ(mesh.counts.triangles, 5u);
    }
  }
}

TEST(PlyReader, ReadsFacesAndStripsOfOneFileInItsOrder) {
  const PlyPart strips{"tristrips", {"list int int vertex_indices"}, {{3, 1, 4, 3}}};
  for (const std::string format : kPlyFormats) {
    const WholeMesh mesh = MustRead(MakePly(format, {kVertices, PlyFaces({{0, 1, 2}}), strips}), 1);
    EXPECT_EQ(mesh.triangles, kTwo) << format;
    EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1}));
  }
}

TEST(PlyReader, CutsPolygonsAndNumbersTrianglesThrough) {
  const PlyPart vertices = PlyVertices({{0, 0, 0}, {4, 0, 0}, {4, 4, 0}, {0, 4, 0}, {1, 2, 0}});
  // A concave pentagon (a fan from corner 0 would leave it), a triangle, a quad.
  const PlyPart faces = PlyFaces({{0, 1, 2, 3, 4}, {0, 1, 2}, {0, 1, 2, 3}});
  for (const std::string format : kPlyFormats) {
    for (const std::size_t batch : {1, 2, 3, 64}) {
      const WholeMesh mesh = MustRead(MakePly(format, {vertices, faces}), batch);
      ASSERT_EQ(mesh.triangles.size(), 6u);
      EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1, 2, 3, 4, 5}));
      double area = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        const auto& [a, b, c] = mesh.triangles[i];
        EXPECT_GT(Cross(b - a, c - a).z, 0);
        area += Cross(b - a, c - a).z / 2;
      }
      EXPECT_EQ(area, 14);
      EXPECT_EQ(mesh.counts.faces, 3u);
    }
  }
}

TEST(PlyReader, CountsFacesThatItSkipsAndLetsThemUseUpNumbers) {
  const PlyPart faces =
      PlyFaces({{0, 1, 2}, {}, {0}, {0, 1}, {0, 1, 5}, {0, 1, -1}, {0, 1, 2, 3, 99}, {1, 4, 3}});
  for (const std::string format : kPlyFormats) {
    for (const std::size_t batch : {1, 64}) {
      const WholeMesh mesh = MustRead(MakePly(format, {kVertices, faces}), batch);
      EXPECT_EQ(mesh.triangles, kTwo);
      EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 9})) << format;
      EXPECT_EQ(mesh.skipped(SkipReason::kTooFewCorners), 3u);
      EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 5u);
      EXPECT_EQ(mesh.counts.triangles, 10u);
      EXPECT_EQ(mesh.counts.faces, 8u);
    }
  }
}

TEST(PlyReader, KeepsFloatsAsFloatsAndDoublesAsDoubles) {
  for (const std::string format : kPlyFormats) {
    auto floats = OpenPly(MemorySource(MakePly(format, {kVertices})), {});
    ASSERT_TRUE(floats) << floats.error().message;
    EXPECT_EQ((*floats)->vertices().f32.size(), 15u);
    PlyPart precise{"vertex", {"double x", "float y", "int z"}, {{0, 0, 0}, {0.1, 0, 16777217}}};
    auto doubles = OpenPly(MemorySource(MakePly(format, {precise})), {});
    ASSERT_TRUE(doubles) << doubles.error().message;
    ASSERT_EQ((*doubles)->vertices().f64.size(), 6u);
    EXPECT_EQ((*doubles)->vertices()[1], (Vec3{0.1, 0, 16777217}));
  }
}

TEST(PlyReader, RoundsDecimalsOnceToTheDeclaredType) {
  const std::string header =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty TYPE x\nproperty TYPE y\nproperty TYPE z\n"
      "end_header\n";
  // The first lies just above the middle of two floats; by way of double it would round to even.
  const std::string row = "1.00000017881393432617187499 -.5e+1 +1E-3\n";
  auto at = [&](const std::string& type) {
    std::string text = header;
    for (std::size_t i; (i = text.find("TYPE")) != std::string::npos;) text.replace(i, 4, type);
    const WholeMesh mesh = MustRead(text + row);
    return mesh.vertices.empty() ? Vec3{} : mesh.vertices[0];
  };
  EXPECT_EQ(at("float"), (Vec3{1.00000011920928955078125, -5, 0.001f}));
  EXPECT_EQ(at("double"), (Vec3{1.00000017881393432617187499, -5, 0.001}));
}

TEST(PlyReader, AcceptsNotANumberAndInfinityAsValues) {
  const double inf = HUGE_VAL;
  const PlyPart vertices = PlyVertices({{NAN, -inf, inf}, {0, 0, 0}, {1, 1, 1}});
  for (const std::string format : kPlyFormats) {
    const WholeMesh mesh = MustRead(MakePly(format, {vertices, PlyFaces({{0, 1, 2}})}));
    ASSERT_EQ(mesh.triangles.size(), 1u);
    EXPECT_TRUE(std::isnan(mesh.triangles[0][0].x));
    EXPECT_EQ(mesh.triangles[0][0].y, -inf);
    EXPECT_EQ(mesh.triangles[0][0].z, inf);
  }
}

TEST(PlyReader, TakesEveryKindOfLineEnd) {
  const std::vector<PlyPart> parts = {kVertices, PlyFaces({{0, 1, 2}, {1, 4, 3}})};
  for (const std::string newline : {"\n", "\r\n", "\r"}) {
    for (const std::string format : kPlyFormats) {
      EXPECT_EQ(MustRead(MakePly(format, parts, newline)).triangles, kTwo) << format;
    }
    std::string ascii = MakePly("ascii", parts, newline);
    ascii.resize(ascii.size() - newline.size());
    EXPECT_EQ(MustRead(ascii).triangles, kTwo) << "without the last line end";
    EXPECT_EQ(MustRead(ascii + " \t" + newline + newline).triangles, kTwo);
  }
}

TEST(PlyReader, DoesNotTakeDataForALineEnd) {
  // The first data byte is a line feed.
  PlyPart vertices{"vertex", {"uchar tag", "float x", "float y", "float z"}, {}};
  for (const Vec3 v : {kA, kB, kC}) vertices.rows.push_back({10, v.x, v.y, v.z});
  const Triangles expected = {{kA, kB, kC}};
  for (const std::string newline : {"\n", "\r\n", "\r"}) {
    const auto bytes = MakePly("binary_little_endian", {vertices, PlyFaces({{0, 1, 2}})}, newline);
    EXPECT_EQ(MustRead(bytes).triangles, expected);
  }
}

TEST(PlyReader, ToleratesBlankLinesAndSpaceAndAMarkInFront) {
  EXPECT_EQ(MustRead("\xef\xbb\xbf \n\tply \nformat ascii 1.0\n\nelement vertex 3 \n"
                     "  property float x\nproperty float y\nproperty\tfloat  z\n"
                     "element face 1\nproperty list uchar int vertex_indices\nend_header \n"
                     "\n 0 0\t0 \n\n1 0 0\n0 1 0\n   \n3 0 1 2")
                .triangles,
            (Triangles{{kA, kB, kC}}));
}

TEST(PlyReader, TakesPointCloudsAndEmptyFilesAsMeshesWithoutTriangles) {
  for (const std::string format : kPlyFormats) {
    for (const auto& parts : std::vector<std::vector<PlyPart>>{
             {}, {kVertices}, {kVertices, PlyFaces({})}, {PlyFaces({}), PlyVertices({})}}) {
      const WholeMesh mesh = MustRead(MakePly(format, parts));
      EXPECT_EQ(mesh.triangles.size(), 0u);
      EXPECT_EQ(mesh.counts.vertices, parts.empty() ? 0 : mesh.vertices.size());
    }
  }
  EXPECT_EQ(MustRead("ply\nformat ascii 1.0\nend_header").counts.faces, 0u);
}

TEST(PlyReader, CountsEveryIndexOutOfRangeWhenThereAreNoVertices) {
  for (const std::string format : kPlyFormats) {
    const WholeMesh mesh = MustRead(MakePly(format, {PlyFaces({{0, 1, 2}, {0, 0, 0, 0}})}));
    EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 3u);
  }
}

TEST(PlyReader, StartsOverAfterRewind) {
  const PlyPart strips{"tristrips", {"list int int vertex_indices"}, {{4, 1, 4, 3, 0}}};
  for (const std::string format : kPlyFormats) {
    const std::string bytes =
        MakePly(format, {strips, PlyFaces({{0, 1, 2, 3, 4}, {0, 1}}), kVertices});
    for (const std::string& packed : {bytes, test::Gzip(bytes), test::Zstd(bytes)}) {
      auto reader = OpenPly(MemorySource(packed), {});
      ASSERT_TRUE(reader) << reader.error().message;
      for (std::size_t reads = 0; reads < 5; ++reads) {
        TriangleBatch batch(1);
        for (std::size_t i = 0; i < reads; ++i) ASSERT_TRUE((*reader)->Read(batch));
        ASSERT_TRUE((*reader)->Rewind());
        auto mesh = ReadWhole(**reader, 2);
        ASSERT_TRUE(mesh) << mesh.error().message;
        EXPECT_EQ(mesh->ids, (std::vector<std::uint64_t>{0, 1, 2, 3, 4})) << reads;
        EXPECT_EQ(mesh->counts.triangles, 6u);
        ASSERT_TRUE((*reader)->Rewind());
      }
    }
  }
}

// A mesh larger than the reader's window, with faces of many kinds; the same in each encoding.
std::vector<PlyPart> LargeMesh(std::uint32_t seed) {
  std::mt19937 random(seed);
  PlyPart vertices = PlyVertices({});
  for (int i = 0; i < 30'000; ++i) {
    vertices.rows.push_back({double(random() % 1000), double(random() % 1000), double(i)});
  }
  PlyPart faces = PlyFaces({});
  for (int i = 0; i < 60'000; ++i) {
    const unsigned kind = random() % 50;
    std::vector<double> row = {double(kind == 0 ? 4 : kind == 1 ? 2 : kind == 2 ? 6 : 3)};
    for (int k = 0; k < row[0]; ++k)
      row.push_back(double(random() % (kind == 3 ? 30'500 : 30'000)));
    faces.rows.push_back(std::move(row));
  }
  return {vertices, faces};
}

TEST(PlyReader, GivesTheSameTrianglesForEveryEncodingWindowAndBatch) {
  const std::uint32_t seed = 20240607;
  SCOPED_TRACE("seed " + std::to_string(seed));
  const std::vector<PlyPart> parts = LargeMesh(seed);
  const WholeMesh first = MustRead(MakePly("ascii", parts));
  EXPECT_GT(first.triangles.size(), 60'000u);
  EXPECT_GT(first.skipped(SkipReason::kIndexOutOfRange), 0u);
  for (const std::string format : kPlyFormats) {
    const std::string bytes = MakePly(format, parts);
    for (const std::size_t most : {std::size_t{997}, SIZE_MAX}) {
      for (const std::size_t batch : {1, 61, 4096}) {
        auto mesh = ReadWhole(OpenPly(test::Dribble(MemorySource(bytes), most), {}), batch);
        ASSERT_TRUE(mesh) << mesh.error().message;
        EXPECT_TRUE(mesh->triangles == first.triangles) << format << " " << batch;
        EXPECT_TRUE(mesh->ids == first.ids);
        EXPECT_EQ(mesh->counts.skipped, first.counts.skipped);
      }
    }
  }
}

// Files that use every part of the reader, small enough for tests at every byte.
std::vector<std::string> SmallFiles() {
  const PlyPart mixed{"vertex",
                      {"uchar red", "double x", "float y", "list uchar char l", "short z"},
                      {{7, 0.1, 0, 1, 5, 0}, {7, 1, 0, 0, 0}, {7, 0, 1, 2, 5, 6, 0}}};
  const PlyPart strips{"tristrips", {"list int int vertex_indices"}, {{5, 0, 1, 2, -1, 0}}};
  const PlyPart extra{"edge", {"int a", "list uchar int b"}, {{1, 1, 2}, {3, 0}}};
  const PlyPart fixed{"tail", {"uchar a", "uchar b"}, {{1, 2}, {3, 4}}};
  std::vector<std::string> files;
  for (const std::string format : kPlyFormats) {
    files.push_back(MakePly(format, {kVertices, PlyFaces({{0, 1, 2}, {1, 4, 3}})}));
    files.push_back(MakePly(format, {extra, PlyFaces({{0, 1, 2, 0}}), mixed, strips, fixed}));
    files.push_back(MakePly(format, {kVertices}, "\r\n"));
  }
  return files;
}

TEST(PlyReader, RefusesEveryProperPrefixOfAValidFile) {
  for (const std::string& bytes : SmallFiles()) {
    const bool ascii = bytes.find("format ascii") != std::string::npos;
    ASSERT_TRUE(Read(bytes));
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      // Ascii without its last line end, or with the last number cut, is a valid file.
      const std::size_t last = bytes.find_last_of(" \n", bytes.find_last_not_of("\r\n"));
      if (ascii && n > last + 1) continue;
      auto mesh = Read(bytes.substr(0, n));
      ASSERT_FALSE(mesh) << n << " of " << bytes;
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
    }
  }
}

TEST(PlyReader, RefusesEveryProperPrefixOfPackedFiles) {
  for (const std::string& bytes : SmallFiles()) {
    for (const std::string& packed : {test::Gzip(bytes), test::Zstd(bytes)}) {
      EXPECT_TRUE(Read(packed));
      for (std::size_t n = 0; n < packed.size(); ++n) {
        auto mesh = Read(packed.substr(0, n));
        ASSERT_FALSE(mesh) << n << " of " << packed.size();
        EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
      }
    }
  }
}

TEST(PlyReader, RefusesEveryPrefixOfTheUnpackedStream) {
  // Here the size is not known beforehand, so the data themselves must be missed.
  for (const std::string& bytes : SmallFiles()) {
    const bool ascii = bytes.find("format ascii") != std::string::npos;
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      const std::size_t last = bytes.find_last_of(" \n", bytes.find_last_not_of("\r\n"));
      if (ascii && n > last + 1) continue;
      auto mesh = Read(test::Gzip(bytes.substr(0, n)));
      ASSERT_FALSE(mesh) << n << " of " << bytes;
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
    }
  }
}

TEST(PlyReader, PassesOnAReadErrorAtAnyByte) {
  for (const std::string& bytes : SmallFiles()) {
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      for (const std::size_t most : {std::size_t{1}, SIZE_MAX}) {
        auto source = std::make_unique<test::FailingSource>(MemorySource(bytes), n, most);
        auto mesh = ReadWhole(OpenPly(std::move(source), {}));
        ASSERT_FALSE(mesh) << n;
        EXPECT_EQ(mesh.error().code, ErrorCode::kIo) << mesh.error().message;
      }
    }
  }
}

TEST(PlyReader, SurvivesEveryChangedByte) {
  for (const std::string& bytes : SmallFiles()) {
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      for (const char c : {'\0', '\n', ' ', '0', '9', '-', '\x7f', '\xff'}) {
        std::string changed = bytes;
        changed[n] = c;
        auto mesh = Read(changed);
        EXPECT_TRUE(mesh || mesh.error().code != ErrorCode::kInternal);
      }
    }
  }
}

TEST(PlyReader, RefusesDataBeyondWhatTheHeaderDeclares) {
  for (const std::string format : kPlyFormats) {
    const std::string bytes = MakePly(format, {kVertices, PlyFaces({{0, 1, 2}, {1, 4, 3}})});
    EXPECT_EQ(MustRead(bytes + "\n \n").triangles, kTwo) << "padding is tolerated";
    ExpectError(bytes + "\n3 0 1 2\n", ErrorCode::kCorruptInput, "expected the end of the file");
  }
}

// An ascii file from a header in short and rows.
std::string Ascii(const std::string& vertex_type, const std::string& face_property,
                  const std::string& rows) {
  std::string text = "ply\nformat ascii 1.0\nelement vertex 3\n";
  for (const char* axis : {"x", "y", "z"}) text += "property " + vertex_type + " " + axis + "\n";
  return text + "element face 1\nproperty " + face_property + "\nend_header\n" + rows;
}

TEST(PlyReader, SaysWhatIsWrongWithAnAsciiRowAndWhere) {
  const std::string list = "list uchar int vertex_indices", good = "0 0 0\n1 0 0\n0 1 0\n";
  const auto expect = [](const std::string& text, const std::string& part) {
    ExpectError(text, ErrorCode::kCorruptInput, part);
  };
  EXPECT_TRUE(Read(Ascii("float", list, good + "3 0 1 2\n")));
  expect(Ascii("float", list, "0 0 0\n1 zero 0\n0 1 0\n3 0 1 2\n"), "line 11: found 'zero'");
  expect(Ascii("float", list, "0 0 0\n1 0\n0 1 0\n3 0 1 2\n"),
         "line 11: found the end of the line");
  expect(Ascii("float", list, "0 0 0\n1 0 0 5\n0 1 0\n3 0 1 2\n"), "line 11: found '5'");
  expect(Ascii("float", list, "0 0 0\n1 0 0x1\n0 1 0\n3 0 1 2\n"), "line 11: found '0x1'");
  expect(Ascii("float", list, "0 0 1e39\n1 0 0\n0 1 0\n3 0 1 2\n"), "line 10: found '1e39'");
  expect(Ascii("double", list, "0 0 1e309\n1 0 0\n0 1 0\n3 0 1 2\n"), "line 10: found '1e309'");
  expect(Ascii("uchar", list, "0 0 256\n1 0 0\n0 1 0\n3 0 1 2\n"), "from 0 to 255");
  expect(Ascii("char", list, "0 0 0\n1 -129 0\n0 1 0\n3 0 1 2\n"), "from -128 to 127");
  expect(Ascii("int", list, "0 0 0.5\n1 0 0\n0 1 0\n3 0 1 2\n"), "line 10: found '0.5'");
  expect(Ascii("float", list, good + "3 0 1\n"), "line 13: found the end of the line");
  expect(Ascii("float", list, good + "3 0 1 2 0\n"), "line 13: found '0'");
  expect(Ascii("float", list, good + "-3 0 1 2\n"), "from 0 to 255");
  expect(Ascii("float", list, good + "256 0 1 2\n"), "from 0 to 255");
  expect(Ascii("float", list, good + "3 0 1 2147483648\n"),
         "found '2147483648', expected an integer from -2147483648 to 2147483647");
  expect(Ascii("float", list, good + "3 0 1 12345678901234567890\n"),
         "found '12345678901234567890', expected an integer");
  expect(Ascii("float", "list char int vertex_indices", good + "-1 0\n"),
         "found '-1', expected an integer from 0 to 127");
  ExpectError(Ascii("float", "list uint int vertex_index", good + "2000000 0 1 2\n"),
              ErrorCode::kUnsupported, "2000000 corners");
}

TEST(PlyReader, RefusesNegativeListLengthsInBinary) {
  for (const std::string format : {"binary_little_endian", "binary_big_endian"}) {
    std::string bytes =
        test::PlyHeaderText(format, {kVertices, {"face", {"list int int vertex_indices"}, {{}}}});
    bytes += std::string(60, '\0') + std::string(8, '\xff');
    ExpectError(bytes, ErrorCode::kCorruptInput, "found list length -1");
  }
}

TEST(PlyReader, RefusesCountsThatDoNotFitTheFile) {
  for (const std::string format : kPlyFormats) {
    for (const char* count : {"4", "1000000000", "18446744073709551615"}) {
      const std::string text = "ply\nformat " + format + " 1.0\nelement vertex " + count +
                               "\nproperty double x\nproperty double y\nproperty double z\n"
                               "end_header\n" +
                               std::string(format == "ascii" ? 5 * 4 : 24 * 3, ' ');
      ExpectError(text, ErrorCode::kCorruptInput, std::string("each of ") + count);
      auto packed = Read(test::Zstd(text));
      ASSERT_FALSE(packed);
      EXPECT_EQ(packed.error().code, ErrorCode::kCorruptInput) << packed.error().message;
    }
  }
}

TEST(PlyReader, PassesOverAnyNumberOfRowsWithoutProperties) {
  for (const std::string format : kPlyFormats) {
    EXPECT_TRUE(
        Read("ply\nformat " + format + " 1.0\nelement nothing 18446744073709551615\nend_header\n"));
  }
}

TEST(PlyReader, SaysWhatIsWrongWithTheHeader) {
  const auto expect = [](const std::string& lines, const std::string& part,
                         ErrorCode code = ErrorCode::kCorruptInput) {
    ExpectError("ply\n" + lines + "\nend_header\n", code, part);
  };
  const std::string ascii = "format ascii 1.0\n";
  expect("", "expected a 'format' line");
  expect("format utf8 1.0", "line 2: found format 'utf8'");
  expect("format", "line 2: found format the end of the line");
  expect("format ascii 2.0", "version '2.0'", ErrorCode::kUnsupported);
  expect(ascii + "format ascii 1.0", "line 3: found a second 'format'");
  expect(ascii + "element a 0\nelements vertex 1", "line 4: found 'elements'");
  EXPECT_TRUE(Read("ply\n" + ascii + "Created by someone\nelement a 0\nend_header\n"));
  expect(ascii + "element", "'element' without a name");
  expect(ascii + "element vertex", "expected the number of 'vertex'");
  expect(ascii + "element vertex -1", "found '-1'");
  expect(ascii + "element vertex 18446744073709551616", "expected the number of");
  expect(ascii + "element a 0\nelement a 0", "second element 'a'");
  expect(ascii + "property float x", "before the first 'element'");
  expect(ascii + "element a 0\nproperty real x", "type 'real'");
  expect(ascii + "element a 0\nproperty float", "without a name");
  expect(ascii + "element a 0\nproperty list float int x", "floating-point");
  expect(ascii + "comment " + std::string(70'000, 'x'), "more than 65536 bytes");
  ExpectError("plywood\n", ErrorCode::kCorruptInput, "expected 'ply' alone");
  ExpectError("obj\n", ErrorCode::kCorruptInput, "expected 'ply'");
  ExpectError("", ErrorCode::kCorruptInput, "expected 'ply'");
  ExpectError("ply\nformat ascii 1.0\nend_header extra\n", ErrorCode::kCorruptInput, "'extra'");
}

TEST(PlyReader, SaysWhichPropertyIsMissingOrTwiceThere) {
  const std::string f = "property float ", face = "element face 1\nproperty ";
  const auto expect = [](const std::string& lines, const std::string& part, ErrorCode code) {
    ExpectError("ply\nformat ascii 1.0\n" + lines + "\nend_header\n1 1 1 1\n1 1 1 1\n", code, part);
  };
  const auto corrupt = ErrorCode::kCorruptInput;
  expect("element vertex 1\n" + f + "x\n" + f + "y", "no property 'z'", corrupt);
  expect("element vertex 1\n" + f + "x\n" + f + "y\n" + f + "z\n" + f + "y", "'y' twice", corrupt);
  expect("element vertex 1\n" + f + "x\n" + f + "y\nproperty list int int z", "list", corrupt);
  expect(face + "float quality", "no property 'vertex_indices'", corrupt);
  expect(face + "float vertex_indices", "not a list of integers", ErrorCode::kUnsupported);
  expect(face + "list uchar float vertex_index", "not a list of integers", ErrorCode::kUnsupported);
  expect(face + "list int int vertex_index\nproperty list int int vertex_indices", "twice",
         corrupt);
}

}  // namespace
}  // namespace strata::io
