#include "io/obj_reader.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/compress.h"
#include "tests/support/failing_source.h"
#include "tests/support/read_mesh.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::ReadWhole;
using test::WholeMesh;

Result<WholeMesh> Read(const std::string& text, const OpenOptions& options = {}) {
  return ReadWhole(OpenObj(MemorySource(text, "m.obj"), options));
}

WholeMesh MustRead(const std::string& text) {
  auto mesh = Read(text);
  EXPECT_TRUE(mesh) << mesh.error().message << "\n" << text;
  return mesh ? *mesh : WholeMesh{};
}

void ExpectError(const std::string& text, const std::string& message) {
  auto mesh = Read(text);
  ASSERT_FALSE(mesh) << text;
  EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);
  EXPECT_EQ(mesh.error().message, "m.obj: " + message);
}

const std::string kSquare = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
const std::array<Vec3, 3> kLower = {Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{1, 1, 0}};

TEST(ObjReader, ReadsTrianglesInFileOrder) {
  const WholeMesh mesh = MustRead("# a comment\n" + kSquare + "f 1 2 3\nf 1 3 4\n");
  ASSERT_EQ(mesh.triangles.size(), 2u);
  EXPECT_EQ(mesh.triangles[0], kLower);
  EXPECT_EQ(mesh.triangles[1], (std::array<Vec3, 3>{Vec3{0, 0, 0}, {1, 1, 0}, {0, 1, 0}}));
  EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1}));
  EXPECT_EQ(mesh.counts.vertices, 4u);
  EXPECT_EQ(mesh.counts.faces, 2u);
  EXPECT_EQ(mesh.counts.triangles, 2u);
  EXPECT_EQ(mesh.info.format, "obj");
  EXPECT_EQ(mesh.info.encoding, "ascii");
  EXPECT_EQ(mesh.info.compression, "none");
}

TEST(ObjReader, LooksAtThePositionOfACornerOnly) {
  for (const char* face : {"f 1 2 3", "f 1/1 2/2 3/3", "f 1//1 2//2 3//3", "f 1/1/1 2/2/2 3/3/3",
                           "f 1/-9 2/0 3/99999999999999999999", "f 1/ 2// 3/1/", "fo 1 2 3",
                           "  \tf\t1  2\t3  ", "f 1 2 3 # 4", "f 1 2 3#4", "f +1 2 3", "f 01 02 03",
                           "f -4 -3 -2", "f -4/-4 -3/-3 -2/-2", "f 1 -3 3"}) {
    const WholeMesh mesh = MustRead(kSquare + face + "\n");
    ASSERT_EQ(mesh.triangles.size(), 1u) << face;
    EXPECT_EQ(mesh.triangles[0], kLower) << face;
  }
}

TEST(ObjReader, CountsNegativeIndicesBackFromTheLine) {
  const WholeMesh mesh =
      MustRead("v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nvt 0 0\nv 5 5 5\nvn 0 0 1\nf -4 -3 -1\n");
  ASSERT_EQ(mesh.triangles.size(), 2u);
  EXPECT_EQ(mesh.triangles[0], kLower);
  EXPECT_EQ(mesh.triangles[1], (std::array<Vec3, 3>{Vec3{0, 0, 0}, {1, 0, 0}, {5, 5, 5}}));
}

TEST(ObjReader, ResolvesFacesThatComeBeforeTheirVertices) {
  const WholeMesh mesh = MustRead("f 1 2 3\n" + kSquare + "f -4 -3 -2\n");
  ASSERT_EQ(mesh.triangles.size(), 2u);
  EXPECT_EQ(mesh.triangles[0], kLower);
  EXPECT_EQ(mesh.triangles[1], kLower);
}

TEST(ObjReader, TakesTheFirstThreeNumbersOfAVertex) {
  for (const char* rest :
       {"", " 1", " 0.5", " 1 0 0", " 1 0 0 1", " nan nan nan", " # note", "\t"}) {
    const std::string end = std::string(rest) + "\n";
    const WholeMesh mesh =
        MustRead("v 0 0 0" + end + "v 1 0 0" + end + "v 1 1 0" + end + "f 1 2 3\n");
    ASSERT_EQ(mesh.triangles.size(), 1u) << rest;
    EXPECT_EQ(mesh.triangles[0], kLower) << rest;
  }
}

TEST(ObjReader, KeepsFloatsAsFloatsAndOthersAsDoubles) {
  auto reader = OpenObj(MemorySource("v 0.1 0.2 0.3\n"), {});
  ASSERT_TRUE(reader);
  EXPECT_EQ((*reader)->vertices().f32.size(), 3u);
  EXPECT_EQ((*reader)->vertices()[0].x, double{0.1f});
  reader = OpenObj(MemorySource("v 0.1 0.2 0.3\nv 364512.261 5812345.12 0.1\n"), {});
  ASSERT_TRUE(reader);
  EXPECT_EQ((*reader)->vertices().f64.size(), 6u);
  EXPECT_EQ((*reader)->vertices()[1].x, 364512.261);
}

TEST(ObjReader, PassesNonFiniteCoordinatesOn) {
  const WholeMesh mesh = MustRead("v nan 0 0\nv 1.#INF -inf 0\nv 0 0 -nan(ind)\nf 1 2 3\n");
  ASSERT_EQ(mesh.triangles.size(), 1u);
  EXPECT_TRUE(std::isnan(mesh.triangles[0][0].x));
  EXPECT_TRUE(std::isinf(mesh.triangles[0][1].x));
}

TEST(ObjReader, CutsPolygonsIntoTriangles) {
  const WholeMesh mesh =
      MustRead("v 0 0 0\nv 4 -1 0\nv 1 0 0\nv 4 1 0\nv 0 3 0\nf 1 2 3 4\nf 1 2 3 4 5\nf 1 2 3\n");
  EXPECT_EQ(mesh.counts.faces, 3u);
  EXPECT_EQ(mesh.counts.triangles, 6u);
  ASSERT_EQ(mesh.triangles.size(), 6u);
  double dart = 0;
  for (int t = 0; t < 2; ++t) {
    const auto& [a, b, c] = mesh.triangles[static_cast<std::size_t>(t)];
    EXPECT_GT(Cross(b - a, c - a).z, 0);
    dart += Cross(b - a, c - a).z;
  }
  EXPECT_EQ(dart, 2);
  EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1, 2, 3, 4, 5}));
}

TEST(ObjReader, SkipsAndCountsFacesThatCannotBe) {
  const WholeMesh mesh = MustRead(kSquare +
                                  "f 1 2 5\nf 0 1 2\nf 1 2 3 4 9\nf -5 -1 -2\nf 1 2\nf 1\nf\n"
                                  "f 1 2 99999999999999999999999\nf 1 2 -99999999999999999999999\n"
                                  "f 1 2 3\n");
  EXPECT_EQ(mesh.counts.faces, 10u);
  EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 8u);
  EXPECT_EQ(mesh.skipped(SkipReason::kTooFewCorners), 3u);
  EXPECT_EQ(mesh.counts.triangles, 12u);
  EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{11}));
}

TEST(ObjReader, JoinsContinuedLines) {
  for (const std::string end : {"\n", "\r\n", "\r"}) {
    const WholeMesh mesh =
        MustRead("v 0 \\" + end + "0 0" + end + "v 1 0 0" + end + "v 1 1\\" + end + "0" + end +
                 "# no \\" + end + "f 1 \\" + end + "  2 \\  " + end + " 3" + end + "f 1 2 3" +
                 end + "usemtl a \\" + end + "f 1 2 3" + end);
    ASSERT_EQ(mesh.triangles.size(), 2u);
    EXPECT_EQ(mesh.triangles[0], kLower);
    EXPECT_EQ(mesh.triangles[1], kLower);
  }
}

TEST(ObjReader, PassesOverEverythingElse) {
  const WholeMesh mesh = MustRead(
      "mtllib does not exist.mtl\no An f name\n" + kSquare +
      "vt x y\nvn\nvp 1\ng f 1 2 3\ns off\nusemtl m\nl 1 2\np 1\nfoo 1 2 3\nvx 1 2\ncurv 0 1 1 2\n"
      "cstype bspline\nend\n\n   \n\t#\nF 1 2 3\nf 1 2 3");
  EXPECT_EQ(mesh.counts.faces, 1u);
  EXPECT_EQ(mesh.counts.vertices, 4u);
}

TEST(ObjReader, GivesNothingForFilesWithoutFaces) {
  for (const std::string& text : {std::string(), std::string("# nothing\n"), kSquare}) {
    EXPECT_EQ(MustRead(text).triangles.size(), 0u);
  }
}

TEST(ObjReader, NamesLineFoundAndExpected) {
  ExpectError("v 0 0 0\nv 0 x 0\n", "line 2: found 'x', expected a number as the vertex's y");
  ExpectError("v 0 0\nf 1 2 3\n",
              "line 1: found the end of the line, expected a number as the vertex's z");
  ExpectError("v 0 0", "line 1: found the end of the file, expected a number as the vertex's z");
  ExpectError("v\n", "line 1: found the end of the line, expected a number as the vertex's x");
  ExpectError("v 1 2 3x\n", "line 1: found '3x', expected a number as the vertex's z");
  ExpectError("v 0x10 2 3\n", "line 1: found '0x10', expected a number as the vertex's x");
  ExpectError(std::string("v 0 0 \0 0\n", 10),
              "line 1: found '?', expected a number as the vertex's z");
  const std::string corner = ", expected a corner such as 1, 1/2, 1//3 or 1/2/3";
  ExpectError(kSquare + "\n\nf 1 2 1.5\n", "line 7: found '1.5'" + corner);
  ExpectError(kSquare + "f 1 2 x\n", "line 5: found 'x'" + corner);
  ExpectError(kSquare + "f 1 2 /3\n", "line 5: found '/3'" + corner);
  ExpectError(kSquare + "f 1 2 3/x\n", "line 5: found '3/x'" + corner);
  ExpectError(kSquare + "f 1 2 -\n", "line 5: found '-'" + corner);
  ExpectError("f 1 2 3\n" + kSquare + "f 1 \\\n2 \\\nx\n", "line 6: found 'x'" + corner);
  ExpectError(kSquare + "f 1 2",
              "line 5: found the end of the file after 2 corners of a face, "
              "expected at least 3");
  ExpectError(kSquare + "f 1 2 3 \\\n",
              "line 5: found the end of the file behind a backslash, expected another line");
}

TEST(ObjReader, RefusesOverlongLinesAndReadsLongOnes) {
  OpenOptions options;
  options.max_line_bytes = 100;
  auto mesh = Read(kSquare + "# " + std::string(99, 'x') + "\nf 1 2 3\n", options);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().message,
            "m.obj: line 5: found a line of 101 bytes or more, expected at most 100");
  std::string joined = kSquare + "f";
  for (int i = 0; i < 60; ++i) joined += " 1\\\n";
  mesh = Read(joined + " 2\n", options);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);

  constexpr int kCorners = 100000;
  std::string text;
  for (int i = 0; i < kCorners; ++i) {
    char line[100];
    const double a = 2 * M_PI * i / kCorners, r = i % 2 == 0 ? 1 : 0.5;
    std::snprintf(line, sizeof line, "v %.9g %.9g 0\n", r * std::cos(a), r * std::sin(a));
    text += line;
  }
  text += "f";
  for (int i = 1; i <= kCorners; ++i) text += " " + std::to_string(i);
  const WholeMesh polygon = MustRead(text + "\n");
  EXPECT_EQ(polygon.triangles.size(), kCorners - 2u);
}

TEST(ObjReader, ReadsEveryLineEndAndByteOrderMark) {
  const std::string text = "\n# x\n" + kSquare + "g a\nf 1 2 3\n\nf -4 -3 -2\n";
  for (const std::string end : {"\n", "\r\n", "\r"}) {
    std::string changed = "\xEF\xBB\xBF";
    for (const char c : text) changed += c == '\n' ? end : std::string(1, c);
    EXPECT_EQ(MustRead(changed).triangles.size(), 2u);
  }
}

TEST(ObjReader, ReadsPackedFilesAndDribblesAlike) {
  std::string text = "vn 0 0 1\n" + kSquare;
  for (int i = 0; i < 1000; ++i)
    text += "f 1 2 3\nv " + std::to_string(i) + " 1 2\nf -1 -2 -3 -4\n";
  const WholeMesh plain = MustRead(text);
  ASSERT_EQ(plain.triangles.size(), 3000u);
  const auto expect_same = [&](std::unique_ptr<ByteSource> source) {
    auto mesh = ReadWhole(OpenObj(std::move(source), {}), 7);
    ASSERT_TRUE(mesh) << mesh.error().message;
    EXPECT_EQ(mesh->triangles, plain.triangles);
    EXPECT_EQ(mesh->ids, plain.ids);
  };
  expect_same(MemorySource(test::Gzip(text)));
  expect_same(MemorySource(test::Zstd(text)));
  expect_same(test::Dribble(MemorySource(text), 1));
  expect_same(test::Dribble(MemorySource(text), 77));
}

TEST(ObjReader, RewindsToTheFirstTriangle) {
  auto reader =
      OpenObj(MemorySource("v 9 9 9\n" + kSquare + "f 2 3 4 5\nf -4 -3 -9\nv 1 2 3\n"), {});
  ASSERT_TRUE(reader);
  TriangleBatch one(1);
  auto n = (*reader)->Read(one);
  ASSERT_TRUE(n);
  EXPECT_EQ(*n, 1u);
  for (int pass = 0; pass < 2; ++pass) {
    ASSERT_TRUE((*reader)->Rewind());
    EXPECT_EQ((*reader)->counts().faces, 0u);
    EXPECT_EQ((*reader)->counts().vertices, 6u);
    auto mesh = ReadWhole(**reader, 1);
    ASSERT_TRUE(mesh);
    EXPECT_EQ(mesh->triangles.size(), 2u);
    EXPECT_EQ(mesh->skipped(SkipReason::kIndexOutOfRange), 1u);
    n = (*reader)->Read(one);
    ASSERT_TRUE(n);
    EXPECT_EQ(*n, 0u);
  }
}

TEST(ObjReader, PassesOnReadErrors) {
  const std::string text = kSquare + "f 1 2 3\nf 1 3 4\n";
  for (std::uint64_t at = 0; at < text.size(); ++at) {
    auto mesh =
        ReadWhole(OpenObj(std::make_unique<test::FailingSource>(MemorySource(text), at, 5), {}));
    ASSERT_FALSE(mesh);
    EXPECT_EQ(mesh.error().code, ErrorCode::kIo);
  }
}

TEST(ObjReader, RefusesPackedFilesThatAreCutOff) {
  const std::string packed = test::Gzip(kSquare + "f 1 2 3\n");
  for (std::size_t n = 20; n < packed.size(); ++n) {
    EXPECT_FALSE(Read(packed.substr(0, n))) << n;
  }
}

// What an OBJ text means, told by the plainest of readers: nothing if it is in error.
struct Meaning {
  std::size_t vertices = 0, faces = 0;
};
std::optional<Meaning> Naive(const std::string& text) {
  Meaning meaning;
  std::istringstream in(text);
  std::string line;
  while (std::getline(in, line)) {
    const bool cut = in.eof();
    if (!line.empty() && line.back() == '\\') {
      std::string next;
      if (!std::getline(in, next)) return std::nullopt;
      line.back() = ' ';
      line += next;
    }
    const bool unfinished = cut || in.eof();
    std::istringstream words(line);
    std::string keyword, word;
    words >> keyword;
    std::size_t n = 0;
    while (words >> word) {
      if (word == "-" || word == "." || word == "-.") return std::nullopt;
      ++n;
    }
    if (keyword == "v" && n < 3) return std::nullopt;
    if (keyword == "f" && n < 3 && unfinished) return std::nullopt;
    meaning.vertices += keyword == "v";
    meaning.faces += keyword == "f";
  }
  return meaning;
}

TEST(ObjReader, TakesEveryPrefixForWhatItSaysOrRefusesIt) {
  const std::string text =
      "v 0 0 0\nv -1.5 .5 0\nv 1 1 -0.25\nvt 0 1\nf 1/1 2/1 3/1\nv 2 2 2\nf -1 -2 \\\n-3 -4\nf 1 "
      "2\n"
      "f 4 3 2\n";
  int refused = 0;
  for (std::size_t n = 0; n <= text.size(); ++n) {
    const std::string prefix = text.substr(0, n);
    SCOPED_TRACE(prefix);
    const auto expected = Naive(prefix);
    auto mesh = Read(prefix);
    ASSERT_EQ(mesh.has_value(), expected.has_value()) << (mesh ? "read" : mesh.error().message);
    if (!mesh) {
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);
      ++refused;
      continue;
    }
    EXPECT_EQ(mesh->counts.vertices, expected->vertices);
    EXPECT_EQ(mesh->counts.faces, expected->faces);
  }
  EXPECT_GT(refused, 40);
}

TEST(ObjReader, ReadsMaterialsBesideItAndNowhereElse) {
  test::TempFolder folder;
  std::filesystem::create_directory(folder / "in");
  test::WriteFile(folder / "secret.mtl", "newmtl secret\n");
  test::WriteFile(
      folder / "in/a b.mtl",
      "newmtl red paint\n map_Kd -s 1 1 1 -clamp on tex\\red paint.png\nnewmtl plain\n");
  test::WriteFile(folder / "in/m.obj",
                  "mtllib a b.mtl\nmtllib ../secret.mtl\nmtllib none.mtl\nmtllib a b.mtl\n"
                  "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl plain\nf 1 2 3\n");
  const auto reader = OpenMesh(folder / "in/m.obj");
  ASSERT_TRUE(reader) << reader.error().message;
  const MeshContents& contents = (*reader)->info().contents;
  EXPECT_EQ(contents.materials, (std::vector<std::string>{"red paint", "plain"}));
  EXPECT_EQ(contents.textures, std::vector<std::string>{"tex\\red paint.png"});
  ASSERT_EQ(contents.passed_over.size(), 1u);
  EXPECT_EQ(contents.passed_over[0].second, 2u);
}

}  // namespace
}  // namespace strata::io
