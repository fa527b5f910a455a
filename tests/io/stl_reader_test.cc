#include "io/stl_reader.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "tests/support/compress.h"
#include "tests/support/failing_source.h"
#include "tests/support/mesh_text.h"
#include "tests/support/read_mesh.h"

namespace strata::io {
namespace {

using test::MakeAsciiStl;
using test::MakeBinaryStl;
using test::NineFloats;
using test::ReadWhole;
using test::WholeMesh;

Result<WholeMesh> Read(const std::string& bytes, std::size_t batch_size = 64) {
  return ReadWhole(OpenStl(MemorySource(bytes, "test.stl"), {}), batch_size);
}

WholeMesh MustRead(const std::string& bytes, std::size_t batch_size = 64) {
  auto mesh = Read(bytes, batch_size);
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? *mesh : WholeMesh{};
}

void ExpectError(const std::string& bytes, const std::string& part) {
  auto mesh = Read(bytes);
  ASSERT_FALSE(mesh) << bytes;
  EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
  EXPECT_NE(mesh.error().message.find(part), std::string::npos) << mesh.error().message;
  EXPECT_TRUE(mesh.error().message.starts_with("test.stl: ")) << mesh.error().message;
}

const std::vector<NineFloats> kFacets = {{0, 0, 0, 1, 0, 0, 0, 1, 0},
                                         {0.1f, -2e-7f, 3e10f, 1, 2, 3, 4, 5, 6}};

std::vector<std::array<Vec3, 3>> Triangles(const std::vector<NineFloats>& facets) {
  std::vector<std::array<Vec3, 3>> triangles;
  for (const NineFloats& f : facets) {
    triangles.push_back({Vec3{f[0], f[1], f[2]}, Vec3{f[3], f[4], f[5]}, Vec3{f[6], f[7], f[8]}});
  }
  return triangles;
}

TEST(StlReader, ReadsAsciiAndBinaryAlike) {
  for (const std::string& bytes : {MakeAsciiStl(kFacets), MakeBinaryStl(kFacets)}) {
    for (const std::string& packed : {bytes, test::Gzip(bytes), test::Zstd(bytes)}) {
      for (const std::size_t batch : {1, 2, 64}) {
        const WholeMesh mesh = MustRead(packed, batch);
        EXPECT_EQ(mesh.triangles, Triangles(kFacets));
        EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 1}));
        EXPECT_EQ(mesh.counts.vertices, 6u);
        EXPECT_EQ(mesh.counts.faces, 2u);
        EXPECT_EQ(mesh.counts.triangles, 2u);
        EXPECT_TRUE(mesh.vertices.empty());
        EXPECT_EQ(mesh.info.format, "stl");
      }
    }
  }
  EXPECT_EQ(MustRead(MakeAsciiStl(kFacets)).info.encoding, "ascii");
  EXPECT_EQ(MustRead(MakeBinaryStl(kFacets)).info.encoding, "binary_little_endian");
}

TEST(StlReader, ReadsBinaryThatBeginsWithSolid) {
  for (const std::string header : {"solid", "solid made by hand", "SOLID facet normal"}) {
    const std::string bytes = MakeBinaryStl(kFacets, header);
    EXPECT_EQ(MustRead(bytes).triangles, Triangles(kFacets));
    EXPECT_EQ(MustRead(test::Gzip(bytes)).triangles, Triangles(kFacets)) << "of unknown size";
  }
  const std::string text_only = MakeBinaryStl(kFacets, "solid" + std::string(75, 'x'));
  EXPECT_EQ(MustRead(text_only).triangles, Triangles(kFacets));
}

TEST(StlReader, ReadsSeveralSolidsWithAnythingForAName) {
  const std::string bytes = MakeAsciiStl({kFacets[0]}, "facet endsolid vertex 1 2") +
                            MakeAsciiStl({}, "") + "\n\n" + MakeAsciiStl({kFacets[1]}, "\xc3\xa4");
  EXPECT_EQ(MustRead(bytes).triangles, Triangles(kFacets));
}

TEST(StlReader, IgnoresCaseIndentationBlankLinesAndNormals) {
  const std::string text =
      "\xef\xbb\xbf\r\nSOLID\r\n FACET normal nan -inf(ind) what\r\nOuter Loop extra\r\n\r\n"
      "\tVertex 0 0 0 \r\nVERTEX +1 0.0e0 0\r\n   vertex\t0  1. 0\r\nEndLoop x\r\nEndFacet y\r\n"
      "endSolid z";
  EXPECT_EQ(MustRead(text).triangles, Triangles({kFacets[0]}));
}

TEST(StlReader, TakesEmptySolidsAsMeshesWithoutTriangles) {
  EXPECT_EQ(MustRead("solid\nendsolid").counts.faces, 0u);
  EXPECT_EQ(MustRead(MakeBinaryStl({})).counts.faces, 0u);
}

TEST(StlReader, RoundsDecimalsToFloats) {
  const std::string text =
      "solid\nfacet\nouter\nvertex 0.1 1.00000017881393432617187499 0\n"
      "vertex 1e-50 nan inf\nvertex 0 0 0\nendloop\nendfacet\nendsolid\n";
  const WholeMesh mesh = MustRead(text);
  ASSERT_EQ(mesh.triangles.size(), 1u);
  EXPECT_EQ(mesh.triangles[0][0].x, 0.1f);
  EXPECT_EQ(mesh.triangles[0][0].y, 1.00000011920928955078125);
  EXPECT_EQ(mesh.triangles[0][1].x, 0);
  EXPECT_TRUE(std::isnan(mesh.triangles[0][1].y));
  EXPECT_EQ(mesh.triangles[0][1].z, HUGE_VAL);
}

TEST(StlReader, RefusesEveryProperPrefixOfAValidFile) {
  const std::string ascii = MakeAsciiStl(kFacets) + MakeAsciiStl({kFacets[0]});
  const std::size_t first_end = MakeAsciiStl(kFacets).size();
  for (const std::string& bytes : {ascii, MakeBinaryStl(kFacets)}) {
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      // "endsolid", its name and the line's end need not be complete to close a solid.
      const bool closed = bytes.substr(0, n).find("endsolid") != std::string::npos &&
                          (n <= first_end || n >= bytes.rfind("endsolid") + 8);
      if (bytes == ascii && closed) continue;
      auto mesh = Read(bytes.substr(0, n));
      ASSERT_FALSE(mesh) << n;
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
      EXPECT_FALSE(Read(test::Gzip(bytes.substr(0, n)))) << n;
    }
    for (const std::string& packed : {test::Gzip(bytes), test::Zstd(bytes)}) {
      for (std::size_t n = 0; n < packed.size(); ++n) EXPECT_FALSE(Read(packed.substr(0, n))) << n;
    }
  }
}

TEST(StlReader, PassesOnAReadErrorAtAnyByte) {
  for (const std::string& bytes : {MakeAsciiStl(kFacets), MakeBinaryStl(kFacets)}) {
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      for (const std::size_t most : {std::size_t{1}, SIZE_MAX}) {
        auto source = std::make_unique<test::FailingSource>(MemorySource(bytes), n, most);
        auto mesh = ReadWhole(OpenStl(std::move(source), {}));
        ASSERT_FALSE(mesh) << n;
        EXPECT_EQ(mesh.error().code, ErrorCode::kIo) << mesh.error().message;
      }
    }
  }
}

TEST(StlReader, SurvivesEveryChangedByte) {
  for (const std::string& bytes : {MakeAsciiStl(kFacets), MakeBinaryStl(kFacets)}) {
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

TEST(StlReader, RefusesACountThatContradictsTheSize) {
  std::string bytes = MakeBinaryStl(kFacets);
  EXPECT_EQ(MustRead(bytes + std::string(3, '\0') + "\n").triangles.size(), 2u)
      << "padding is tolerated";
  ExpectError(bytes + bytes.substr(84, 50), "found more data");
  bytes[80] = 3;
  ExpectError(bytes, "counts 3 facets, for which the file must have 234 bytes; found 184");
  bytes[83] = '\x7f';
  ExpectError(bytes, "must have 106535321834 bytes");
  ExpectError(test::Zstd(bytes), "the file ends");
}

TEST(StlReader, SaysWhatIsWrongWithAsciiAndWhere) {
  const std::string facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n";
  const std::string end = "vertex 0 1 0\nendloop\nendfacet\nendsolid\n";
  EXPECT_TRUE(Read("solid\n" + facet + end));
  ExpectError("solid\nvertex 0 0 0\n", "line 2: found 'vertex', expected 'facet' or 'endsolid'");
  ExpectError("solid\n" + facet + "vertex 0 1\n", "line 6: found the end of the line");
  ExpectError("solid\n" + facet + "vertex 0 1 x\n", "line 6: found 'x', expected a number");
  ExpectError("solid\n" + facet + "vertex 0 1 0 0\n", "line 6: found '0', expected the end of");
  ExpectError("solid\n" + facet + "vertex 0 1 1e39\n", "in the type's range");
  ExpectError("solid\n" + facet + "endloop\n", "line 6: found 'endloop', expected 'vertex'");
  ExpectError("solid\n" + facet + "vertex 0 1 0\n" + end,
              "line 7: found 'vertex', expected 'endloop'");
  ExpectError("solid\n" + facet + end + "facet\n", "line 10: found 'facet', expected 'solid'");
  ExpectError("solid\n" + facet + "vertex 0 1 0\nendloop\nendfacet\n", "found the end of the file");
}

TEST(StlReader, StartsOverAfterRewind) {
  for (const std::string& bytes : {MakeAsciiStl(kFacets), MakeBinaryStl(kFacets)}) {
    for (const std::string& packed : {bytes, test::Gzip(bytes)}) {
      auto reader = OpenStl(MemorySource(packed), {});
      ASSERT_TRUE(reader) << reader.error().message;
      for (std::size_t reads = 0; reads < 4; ++reads) {
        TriangleBatch batch(1);
        for (std::size_t i = 0; i < reads; ++i) ASSERT_TRUE((*reader)->Read(batch));
        ASSERT_TRUE((*reader)->Rewind());
        auto mesh = ReadWhole(**reader);
        ASSERT_TRUE(mesh) << mesh.error().message;
        EXPECT_EQ(mesh->triangles, Triangles(kFacets));
        EXPECT_EQ(mesh->counts.triangles, 2u);
        ASSERT_TRUE((*reader)->Rewind());
      }
    }
  }
}

TEST(StlReader, GivesTheSameTrianglesForEveryEncodingWindowAndBatch) {
  const std::uint32_t seed = 42;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random(seed);
  std::vector<NineFloats> facets(20'000, NineFloats(9));
  for (auto& f : facets) {
    for (float& value : f) value = static_cast<float>(random()) / 1000.0f;
  }
  const auto expected = Triangles(facets);
  for (const std::string& bytes : {MakeAsciiStl(facets), MakeBinaryStl(facets)}) {
    for (const std::size_t most : {std::size_t{997}, SIZE_MAX}) {
      for (const std::size_t batch : {1, 61, 4096}) {
        auto mesh = ReadWhole(OpenStl(test::Dribble(MemorySource(bytes), most), {}), batch);
        ASSERT_TRUE(mesh) << mesh.error().message;
        EXPECT_TRUE(mesh->triangles == expected) << batch;
      }
    }
  }
}

}  // namespace
}  // namespace strata::io
