#include "io/off_reader.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "tests/support/compress.h"
#include "tests/support/failing_source.h"
#include "tests/support/read_mesh.h"

namespace strata::io {
namespace {

using test::ReadWhole;
using test::WholeMesh;

Result<WholeMesh> Read(const std::string& text, const OpenOptions& options = {}) {
  return ReadWhole(OpenOff(MemorySource(text, "m.off"), options));
}

WholeMesh MustRead(const std::string& text) {
  auto mesh = Read(text);
  EXPECT_TRUE(mesh) << mesh.error().message << "\n" << text;
  return mesh ? *mesh : WholeMesh{};
}

void ExpectError(const std::string& text, const std::string& message,
                 ErrorCode code = ErrorCode::kCorruptInput) {
  auto mesh = Read(text);
  ASSERT_FALSE(mesh) << text;
  EXPECT_EQ(mesh.error().code, code);
  EXPECT_EQ(mesh.error().message, "m.off: " + message);
}

const std::string kBody = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n";
const std::array<Vec3, 3> kLower = {Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{1, 1, 0}};

void ExpectSquare(const std::string& text) {
  const WholeMesh mesh = MustRead(text);
  ASSERT_EQ(mesh.triangles.size(), 2u) << text;
  EXPECT_EQ(mesh.triangles[0], kLower) << text;
  EXPECT_EQ(mesh.counts.vertices, 4u);
  EXPECT_EQ(mesh.counts.faces, 2u);
}

TEST(OffReader, ReadsTrianglesInFileOrder) {
  const WholeMesh mesh = MustRead("OFF\n4 2 5\n" + kBody);
  ASSERT_EQ(mesh.triangles.size(), 2u);
  EXPECT_EQ(mesh.triangles[0], kLower);
  EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1}));
  EXPECT_EQ(mesh.info.format, "off");
  EXPECT_EQ(mesh.info.encoding, "ascii");
}

TEST(OffReader, AcceptsEveryHeaderInUse) {
  for (const char* header :
       {"OFF\n4 2 0\n", "OFF 4 2 0\n", "OFF4 2 0\n", "4 2 0\n", "OFF\n4 2\n", "OFF # x\n4 2 0\n",
        "# x\n\nOFF\n\n# y\n 4\t2 0 # z\n", "  \tOFF\n4 2 0\n", "COFF\n4 2 0\n", "NOFF\n4 2 0\n",
        "STOFF\n4 2 0\n", "CNOFF\n4 2 0\n", "NCOFF\n4 2 0\n", "STCNOFF\n4 2 0\n", "CSTNOFF 4 2 0\n",
        "OFF\r\n4 2 0\r\n", "\xEF\xBB\xBFOFF\n4 2 0\n"}) {
    ExpectSquare(header + kBody);
  }
}

TEST(OffReader, LooksAtPositionsAndCornersOnly) {
  for (const char* after_vertex : {"", " 0.1 0.2 0.3", " 255 0 0 255", " 0 0 1 255 0 0 255 0.5 0.5",
                                   " # red", "#red", " what ever"}) {
    for (const char* after_face :
         {"", " 7", " 0.9 0 0", " 255 255 0", " 1 0 0 0.5", "#red", " # red", "\t", " red"}) {
      std::string text = "COFF\n4 2 0\n\n";
      for (const char* v : {"0 0 0", "1 0 0", "1 1 0", "0 1 0"}) {
        text += std::string(v) + after_vertex + "\n# between\n\n";
      }
      for (const char* f : {"3 0 1 2", "3 0 2 3"}) text += std::string(f) + after_face + "\n\n";
      ExpectSquare(text);
    }
  }
}

TEST(OffReader, CutsPolygonsAndCountsSkippedFaces) {
  const WholeMesh mesh = MustRead(
      "OFF\n4 9 0\n0 0 0\n4 -1 0\n1 0 0\n4 1 0\n4 0 1 2 3\n3 0 1 4\n3 0 1 -1\n2 0 1\n1 0\n0\n"
      "5 0 1 2 3 99\n3 0 1 99999999999999999999\n3 0 1 2\n");
  EXPECT_EQ(mesh.counts.faces, 9u);
  EXPECT_EQ(mesh.counts.triangles, 2u + 1 + 1 + 3 + 3 + 1 + 1);
  EXPECT_EQ(mesh.triangles.size(), 3u);
  EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 6u);
  EXPECT_EQ(mesh.skipped(SkipReason::kTooFewCorners), 3u);
  EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1, 11}));
}

TEST(OffReader, ReadsMeshesWithoutFacesOrVertices) {
  EXPECT_EQ(MustRead("OFF\n0 0 0\n").triangles.size(), 0u);
  EXPECT_EQ(MustRead("OFF 0 0").triangles.size(), 0u);
  EXPECT_EQ(MustRead("OFF\n1 0 0\n1 2 3\n# end\n\n").counts.vertices, 1u);
}

TEST(OffReader, RefusesOtherDimensionsAndBinaryByName) {
  for (const std::string keyword : {"4OFF", "nOFF", "4nOFF", "STCN4OFF", "C4OFF", "OFF BINARY"}) {
    ExpectError(keyword + "\n4 2 0\n" + kBody,
                "line 1: found " + keyword +
                    ", which is not supported; expected OFF in three dimensions and in text form "
                    "(OFF, COFF, NOFF, STOFF or a mixture)",
                ErrorCode::kUnsupported);
  }
}

TEST(OffReader, NamesLineFoundAndExpected) {
  ExpectError("", "line 1: found the end of the file, expected an OFF header");
  ExpectError("ply\n", "line 1: found 'ply', expected an OFF header");
  ExpectError("CCOFF\n", "line 1: found 'CCOFF', expected an OFF header");
  ExpectError("OFF\n",
              "line 1: found the end of the file, expected the numbers of vertices and faces");
  ExpectError("OFF\nx\n", "line 2: found 'x', expected the number of vertices");
  ExpectError("OFF\n4\n", "line 2: found the end of the line, expected the number of faces");
  ExpectError("OFF\n4 -2 0\n", "line 2: found '-2', expected the number of faces");
  ExpectError("OFF\n4.5 2 0\n", "line 2: found '4.5', expected the number of vertices");
  ExpectError("OFF\n99999999999999999999 2 0\n",
              "line 2: found '99999999999999999999', expected the number of vertices");
  ExpectError("OFF\n4 2 0\n0 0 0\n1 x 0\n",
              "line 4: found 'x', expected a number as the vertex's y");
  ExpectError("OFF\n4 2 0\n0 0 0\n1 0\n",
              "line 4: found the end of the line, expected a number as the vertex's z");
  ExpectError("OFF\n4000000000000 2 0\n0 0 0\n1 0 0\n",
              "line 4: found the end of the file, expected 4000000000000 vertices, of which there "
              "were 2");
  const std::string head = "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n";
  ExpectError(head + "3 0 1 2\n",
              "line 6: found the end of the file, expected 2 faces, of which there were 1");
  ExpectError(head + "x 0 1 2\n", "line 6: found 'x', expected the number of the face's corners");
  ExpectError(head + "-3 0 1 2\n", "line 6: found '-3', expected the number of the face's corners");
  ExpectError(head + "4 0 1 2\n", "line 6: found the end of the line, expected corner 4 of 4");
  ExpectError(head + "4000000000000 0 1 2\n",
              "line 6: found the end of the line, expected corner 4 of 4000000000000");
  ExpectError(head + "3 0 1.5 2\n", "line 6: found '1.5', expected corner 2 of 3");
  ExpectError(head + std::string("3 0 \0 2\n", 8), "line 6: found '?', expected corner 2 of 3");
  ExpectError(head + "3 0 1 2\n3 0 1 2\n3 0 1 2\n",
              "line 8: found '3', expected nothing more, as the header says 2 faces");
}

TEST(OffReader, RefusesOverlongLines) {
  OpenOptions options;
  options.max_line_bytes = 50;
  auto mesh = Read("OFF\n4 2 0\n#" + std::string(50, 'x') + "\n" + kBody, options);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().message,
            "m.off: line 3: found a line of 51 bytes or more, expected at most 50");
}

TEST(OffReader, ReadsPackedFilesAndDribblesAlike) {
  std::string text = "OFF\n500 500 0\n";
  for (int i = 0; i < 500; ++i) text += std::to_string(i) + " 0.5 " + std::to_string(i * i) + "\n";
  for (int i = 0; i < 500; ++i) text += "4 1 2 " + std::to_string(i) + " 499\n";
  const WholeMesh plain = MustRead(text);
  ASSERT_EQ(plain.triangles.size(), 1000u);
  const auto expect_same = [&](std::unique_ptr<ByteSource> source) {
    auto mesh = ReadWhole(OpenOff(std::move(source), {}), 7);
    ASSERT_TRUE(mesh) << mesh.error().message;
    EXPECT_EQ(mesh->triangles, plain.triangles);
    EXPECT_EQ(mesh->ids, plain.ids);
  };
  expect_same(MemorySource(test::Gzip(text)));
  expect_same(MemorySource(test::Zstd(text)));
  expect_same(test::Dribble(MemorySource(text), 1));
}

TEST(OffReader, RewindsToTheFirstTriangle) {
  auto reader = OpenOff(
      MemorySource("OFF\n4 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n2 0 1\n3 0 1 2"), {});
  ASSERT_TRUE(reader);
  TriangleBatch one(1);
  ASSERT_TRUE((*reader)->Read(one));
  for (int pass = 0; pass < 2; ++pass) {
    ASSERT_TRUE((*reader)->Rewind());
    EXPECT_EQ((*reader)->counts().faces, 0u);
    auto mesh = ReadWhole(**reader, 1);
    ASSERT_TRUE(mesh) << mesh.error().message;
    EXPECT_EQ(mesh->triangles.size(), 3u);
    EXPECT_EQ(mesh->counts.triangles, 4u);
  }
}

TEST(OffReader, PassesOnReadErrors) {
  const std::string text = "OFF\n4 2 0\n" + kBody;
  for (std::uint64_t at = 0; at < text.size(); ++at) {
    auto mesh =
        ReadWhole(OpenOff(std::make_unique<test::FailingSource>(MemorySource(text), at, 5), {}));
    ASSERT_FALSE(mesh);
    EXPECT_EQ(mesh.error().code, ErrorCode::kIo);
  }
}

TEST(OffReader, RefusesEveryPrefixThatMissesMoreThanTheLastLineEnd) {
  const std::string text =
      "COFF\n4 2 0\n0 0 0 1 1 1\n1 0 0 1 1 1\n1 1 0 1 1 1\n0 1 0 1 1 1\n3 0 1 2\n3 0 2 3\n";
  for (std::size_t n = 0; n + 1 < text.size(); ++n) {
    auto mesh = Read(text.substr(0, n));
    ASSERT_FALSE(mesh) << text.substr(0, n);
    EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);
  }
  ExpectSquare(text.substr(0, text.size() - 1));
}

}  // namespace
}  // namespace strata::io
