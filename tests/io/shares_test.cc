// Reading one share of a mesh's triangles, and no more of the file than that.
#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/counting_source.h"
#include "tests/support/failing_source.h"
#include "tests/support/mesh_text.h"
#include "tests/support/read_mesh.h"
#include "tests/support/soup.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::ReadWhole;
using test::Soup;
using test::WholeMesh;

constexpr std::uint32_t kCounts[] = {1, 2, 3, 7};
constexpr std::uint64_t kTriangles = 500'000;  // About; in 8 blocks, the last one short.
const char* const kBinary[] = {"binary_little_endian", "binary_big_endian", "stl"};

// A sphere, some of whose triangles name a vertex that does not exist.
const Soup& Sphere() {
  static const Soup soup = [] {
    Soup made = test::SphereSoup(kTriangles, test::Order::kCoherent, false);
    for (std::size_t i = 5; i < made.faces.size(); i += 9999) made.faces[i][i % 3] += 1u << 30;
    return made;
  }();
  return soup;
}

std::string SphereStl() {
  std::vector<test::NineFloats> facets;
  for (const auto& face : test::SphereSoup(kTriangles, test::Order::kCoherent, false).faces) {
    facets.emplace_back();
    for (const std::uint64_t i : face) {
      for (const float x : Sphere().vertices[i]) facets.back().push_back(x);
    }
  }
  return test::MakeBinaryStl(facets);
}

// Made once: they are large.
const std::string& Bytes(const std::string& format) {
  static std::map<std::string, std::string> made;
  std::string& bytes = made[format];
  if (bytes.empty()) bytes = format == "stl" ? SphereStl() : test::SoupBytes(Sphere(), format);
  return bytes;
}

std::unique_ptr<MeshReader> MustOpen(std::unique_ptr<ByteSource> source,
                                     const OpenOptions& options = {}) {
  auto reader = OpenMesh(std::move(source), options);
  EXPECT_TRUE(reader) << reader.error().message;
  return reader ? std::move(*reader) : nullptr;
}
std::unique_ptr<MeshReader> MustOpen(const std::string& bytes, const OpenOptions& options = {}) {
  return MustOpen(MemorySource(bytes, "mesh"), options);
}

WholeMesh MustRead(MeshReader& reader, std::size_t batch = 2048) {
  auto mesh = ReadWhole(reader, batch);
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? std::move(*mesh) : WholeMesh{};
}

void AddCounts(const ReadCounts& more, ReadCounts& sum) {
  sum.vertices += more.vertices;
  sum.faces += more.faces;
  sum.triangles += more.triangles;
  for (std::size_t r = 0; r < sum.skipped.size(); ++r) sum.skipped[r] += more.skipped[r];
}

bool SameCounts(const ReadCounts& a, const ReadCounts& b) {
  return a.vertices == b.vertices && a.faces == b.faces && a.triangles == b.triangles &&
         a.skipped == b.skipped;
}

using TriangleById = std::map<std::uint64_t, std::array<Vec3, 3>>;

// Every triangle of `mesh` is the share's and new to `all`.
void Collect(const WholeMesh& mesh, const Share& share, TriangleById& all) {
  for (std::size_t i = 0; i < mesh.ids.size(); ++i) {
    ASSERT_TRUE(share.Holds(mesh.ids[i])) << mesh.ids[i];
    ASSERT_TRUE(i == 0 || mesh.ids[i - 1] < mesh.ids[i]);
    ASSERT_TRUE(all.emplace(mesh.ids[i], mesh.triangles[i]).second) << mesh.ids[i];
  }
}

TriangleById ById(const WholeMesh& mesh) {
  TriangleById all;
  Collect(mesh, {}, all);
  return all;
}

void ExpectSharesAreWhole(const std::string& bytes, std::size_t batch,
                          const OpenOptions& options = {}) {
  const WholeMesh whole = MustRead(*MustOpen(bytes));
  const TriangleById expected = ById(whole);
  for (const std::uint32_t count : kCounts) {
    TriangleById all;
    ReadCounts counts;
    for (std::uint32_t index = 0; index < count; ++index) {
      const auto reader = MustOpen(bytes, options);
      const Share share{index, count};
      ASSERT_TRUE(reader->SelectShare(share));
      const WholeMesh part = MustRead(*reader, batch);
      Collect(part, share, all);
      AddCounts(part.counts, counts);
    }
    EXPECT_TRUE(all == expected) << count;
    EXPECT_TRUE(SameCounts(counts, whole.counts)) << count;
  }
}

TEST(Shares, OfBinaryFilesAreTogetherTheWholeMesh) {
  for (const std::string format : kBinary) {
    SCOPED_TRACE(format);
    for (const std::size_t batch : {1000, 2048}) ExpectSharesAreWhole(Bytes(format), batch);
  }
  const WholeMesh whole = MustRead(*MustOpen(Bytes("binary_little_endian")));
  EXPECT_GT(whole.skipped(SkipReason::kIndexOutOfRange), 40u) << "or the test shows less";
}

TEST(Shares, AreTheSameWhereVerticesExceedTheirBudget) {
  const test::TempFolder parent;
  const auto scratch = ScratchFolder::Open(parent.path());
  ASSERT_TRUE(scratch);
  for (const auto order : {test::Order::kCoherent, test::Order::kAllShuffled}) {
    const Soup soup = test::SphereSoup(200'000, order, false);
    const std::string bytes = test::SoupBytes(soup, "binary_little_endian");
    OpenOptions options;
    options.vertex_budget = soup.vertices.size() * 12 / 8;
    options.scratch = scratch->get();
    ExpectSharesAreWhole(bytes, 2048, options);
  }
}

TEST(Shares, ReadOnlyTheirOwnPartOfTheFile) {
  for (const std::string format : kBinary) {
    for (const std::uint32_t count : {2u, 7u}) {
      std::uint64_t sum = 0, triangles = 0;
      for (std::uint32_t index = 0; index < count; ++index) {
        std::uint64_t read = 0;
        const auto reader = MustOpen(
            std::make_unique<test::CountingSource>(MemorySource(Bytes(format), "mesh"), &read));
        const std::uint64_t opening = read;
        ASSERT_TRUE(reader->SelectShare({index, count}));
        triangles += MustRead(*reader).counts.triangles;
        sum += read - opening;
      }
      const std::uint64_t row = format == "stl" ? 50 : 13;
      EXPECT_EQ(triangles, Sphere().faces.size());
      // Less what the window held from opening on, which no one has to read again.
      EXPECT_LE(sum, triangles * row) << format << ' ' << count;
      EXPECT_GE(sum + count * (std::uint64_t{1} << 18), triangles * row) << format << ' ' << count;
    }
  }
}

TEST(Shares, StaySelectedThroughRewindUntilTheWholeIsAskedFor) {
  for (const std::string format : kBinary) {
    const auto reader = MustOpen(Bytes(format));
    const WholeMesh whole = MustRead(*reader);
    ASSERT_TRUE(reader->Rewind());
    ASSERT_TRUE(reader->SelectShare({1, 3}));
    const WholeMesh part = MustRead(*reader);
    EXPECT_LT(part.ids.size(), whole.ids.size());
    for (const std::size_t batches : {0, 1, 50}) {
      ASSERT_TRUE(reader->Rewind());
      TriangleBatch batch(2048);
      for (std::size_t i = 0; i < batches; ++i) ASSERT_TRUE(reader->Read(batch));
      ASSERT_TRUE(reader->Rewind());
      const WholeMesh again = MustRead(*reader);
      EXPECT_EQ(again.ids, part.ids);
      EXPECT_TRUE(again.triangles == part.triangles);
      EXPECT_TRUE(SameCounts(again.counts, part.counts));
    }
    EXPECT_TRUE(reader->SelectShare({}));
    ASSERT_TRUE(reader->Rewind());
    const WholeMesh all = MustRead(*reader);
    EXPECT_EQ(all.ids, whole.ids);
    EXPECT_TRUE(all.triangles == whole.triangles);
    EXPECT_TRUE(SameCounts(all.counts, whole.counts));
  }
}

// Faces in rows of an unusual kind between the vertices and another element.
std::string UnusualPly(const std::string& format, const std::string& list, bool faces_first) {
  test::PlyPart vertices = test::PlyVertices({}), faces{"face", {"double a", list, "short b"}, {}};
  for (int i = 0; i < 1000; ++i) vertices.rows.push_back({i * 0.5, i * 0.25, -i * 1.0});
  for (int i = 0; i < 150'000; ++i) {
    faces.rows.push_back({0.1, 3, i % 1000 * 1.0, i % 999 * 1.0, i % 997 * 1.0, 7});
  }
  const test::PlyPart edges{"edge", {"int vertex1", "uchar c"}, {{1, 2}, {3, 4}}};
  if (faces_first) return test::MakePly(format, {faces, vertices, edges});
  return test::MakePly(format, {vertices, faces, edges});
}

TEST(Shares, OfPlyMayHaveAnyTypesAndOtherElementsAround) {
  for (const std::string format : {"binary_little_endian", "binary_big_endian"}) {
    for (const std::string list :
         {"list uchar int vertex_indices", "list int ushort vertex_index"}) {
      for (const bool faces_first : {false, true}) {
        SCOPED_TRACE(format + " " + list + (faces_first ? " first" : ""));
        ExpectSharesAreWhole(UnusualPly(format, list, faces_first), 2048);
      }
    }
  }
}

TEST(Shares, AreLeftToTheCallerWhereTheFileDoesNotTellTheirPlaces) {
  const Soup small = test::SphereSoup(2000, test::Order::kCoherent, false);
  const Soup polygons = test::SphereSoup(2000, test::Order::kCoherent, true);
  const std::string ply = test::SoupBytes(small, "binary_little_endian");
  const test::PlyPart strips{"tristrips", {"list int int vertex_indices"}, {{3, 0, 1, 2}}};
  const std::string stl = test::MakeBinaryStl({{0, 0, 0, 1, 0, 0, 0, 1, 0}});
  const std::vector<std::string> files = {
      test::SoupBytes(small, "ascii"),
      test::SoupBytes(small, "obj"),
      test::SoupBytes(small, "off"),
      test::MakeAsciiStl({{0, 0, 0, 1, 0, 0, 0, 1, 0}}),
      test::Gzip(ply),
      test::Zstd(ply),
      test::Gzip(stl),
      test::SoupBytes(polygons, "binary_little_endian"),
      ply + '\n',  // Padding may as well be a face's last byte.
      test::MakePly("binary_little_endian", {test::PlyVertices({{0, 0, 0}}), strips}),
      test::MakePly("binary_little_endian", {test::PlyVertices({{0, 0, 0}})}),
      test::MakePly("binary_little_endian",
                    {test::PlyVertices({{0, 0, 0}}), test::PlyFaces({{0, 0, 0}}), strips})};
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto reader = MustOpen(files[i]);
    const WholeMesh whole = MustRead(*reader);
    for (std::uint32_t index = 0; index < 2; ++index) {
      ASSERT_TRUE(reader->Rewind());
      EXPECT_FALSE(reader->SelectShare({index, 2})) << i;
      const WholeMesh again = MustRead(*reader);
      EXPECT_EQ(again.ids, whole.ids) << i;
      EXPECT_TRUE(SameCounts(again.counts, whole.counts)) << i;
    }
    EXPECT_TRUE(reader->SelectShare({})) << i;
  }
}

// Triangles but for the faces number `at` and `at` + `apart`, of two corners and of four.
std::string MixedOfTriangleSize(std::size_t at, std::size_t apart) {
  test::PlyPart vertices = test::PlyVertices({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}});
  std::vector<std::vector<double>> faces(200'000, {0, 1, 2});
  faces[at] = {0, 1};
  faces[at + apart] = {0, 1, 2, 3};
  return test::MakePly("binary_little_endian", {vertices, test::PlyFaces(faces)});
}

TEST(Shares, OfOtherPolygonsOfTheSameSizeAreRefusedByOneAtLeast) {
  for (const std::size_t at : {0, 65'535, 65'536, 131'071, 150'000}) {
    for (const std::size_t apart : {1, 3000, 40'000}) {
      const std::string bytes = MixedOfTriangleSize(at, apart);
      EXPECT_EQ(MustRead(*MustOpen(bytes)).counts.faces, 200'000u) << "as a whole it can be read";
      for (const std::uint32_t count : {2u, 3u, 7u}) {
        const auto owner = static_cast<std::uint32_t>((at >> 16) % count);
        const auto reader = MustOpen(bytes);
        for (std::uint32_t index = 0; index < count; ++index) {
          EXPECT_TRUE(reader->SelectShare({index, count})) << "all shares decide alike";
        }
        ASSERT_TRUE(reader->SelectShare({owner, count}));
        const auto part = ReadWhole(*reader, 2048);
        ASSERT_FALSE(part) << at << ' ' << apart << ' ' << count;
        EXPECT_EQ(part.error().code, ErrorCode::kUnsupported);
        EXPECT_NE(part.error().message.find("found a face of 2 corners"), std::string::npos)
            << part.error().message;
      }
    }
  }
}

TEST(Shares, PassOnAReadErrorInTheirOwnPartOnly) {
  for (const std::string format : kBinary) {
    const std::string& bytes = Bytes(format);
    // In the middle of the last block of all, which is number 7.
    const std::uint64_t fail_at = bytes.size() - 10'000;
    for (const std::uint32_t index : {0u, 1u, 2u}) {
      auto source = std::make_unique<test::FailingSource>(MemorySource(bytes, "mesh"), fail_at);
      const auto reader = MustOpen(std::move(source));
      ASSERT_TRUE(reader->SelectShare({index, 3}));
      const auto part = ReadWhole(*reader, 2048);
      if (index != 7 % 3 && format != "stl") {
        EXPECT_TRUE(part) << part.error().message;
      } else if (index == 7 % 3) {
        ASSERT_FALSE(part);
        EXPECT_EQ(part.error().code, ErrorCode::kIo);
      }
    }
  }
}

TEST(Shares, OfATruncatedPlyAreNotGuessed) {
  const std::string& bytes = Bytes("binary_little_endian");
  for (const std::size_t less : {1u, 13u, 1'000'000u}) {
    auto reader = OpenMesh(MemorySource(bytes.substr(0, bytes.size() - less), "mesh"), {});
    if (!reader) continue;
    EXPECT_FALSE((*reader)->SelectShare({0, 2}));
    const auto part = ReadWhole(**reader, 2048);
    ASSERT_FALSE(part);
    EXPECT_EQ(part.error().code, ErrorCode::kCorruptInput);
  }
}

TEST(Shares, FindTheirNextTriangleAsHoldsSays) {
  for (const std::uint32_t count : kCounts) {
    for (std::uint32_t index = 0; index < count; ++index) {
      const Share share{index, count};
      for (std::uint64_t from = 0; from < 20 * Share::kBlock; from += Share::kBlock / 2 - 1) {
        std::uint64_t next = from;
        while (!share.Holds(next)) next = (next / Share::kBlock + 1) * Share::kBlock;
        ASSERT_EQ(share.Next(from), next);
        ASSERT_TRUE(share.RunEnd(next) == UINT64_MAX || share.RunEnd(next) > next);
        ASSERT_TRUE(count == 1 || share.RunEnd(next) % Share::kBlock == 0);
      }
      const std::uint64_t last = share.Next(UINT64_MAX - 5);
      EXPECT_TRUE(last == UINT64_MAX || share.Holds(last));
    }
  }
}

}  // namespace
}  // namespace strata::io
