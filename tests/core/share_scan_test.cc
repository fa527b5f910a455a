// A mesh scanned in shares: what all of them leave together is what one scan leaves.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/block_merge.h"
#include "core/scan_mesh.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/soup.h"

namespace strata::test {
namespace {

constexpr std::uint32_t kCounts[] = {1, 2, 3, 7};

// 4 blocks of triangles; some name a vertex that does not exist, some have no area.
const Soup& Sphere() {
  static const Soup soup = [] {
    Soup made = SphereSoup(250'000, Order::kCoherent, false);
    for (std::size_t i = 5; i < made.faces.size(); i += 9999) made.faces[i][1] += 1u << 30;
    for (std::size_t i = 7; i < made.faces.size(); i += 7777) made.faces[i][1] = made.faces[i][2];
    return made;
  }();
  return soup;
}

SampleOptions Options(const LatticeSpec& lattice) {
  SampleOptions options;
  options.lattice = lattice;
  options.threads = 2;
  options.attributes = kNormal | kBarycentric;
  return options;
}

ScannedMesh MustScan(MeshReader& reader, const LatticeSpec& lattice, const Share& share) {
  RunContext context;
  auto scanned = ScanMesh(reader, Options(lattice), share, {}, context);
  EXPECT_TRUE(scanned) << scanned.error().message;
  return scanned ? std::move(*scanned) : ScannedMesh{};
}

std::unique_ptr<MeshReader> MustOpen(const std::string& bytes) {
  auto reader = io::OpenMesh(io::MemorySource(bytes, "mesh"), {});
  EXPECT_TRUE(reader) << reader.error().message;
  return reader ? std::move(*reader) : nullptr;
}

// The reservoirs of several stores as one.
std::vector<BlockReservoirs> Merged(const std::vector<ScannedMesh>& parts) {
  std::vector<std::unique_ptr<BlockStream>> streams;
  for (const ScannedMesh& part : parts) streams.push_back(part.store->grid().Blocks());
  BlockMerge merge(std::move(streams));
  std::vector<BlockReservoirs> blocks;
  BlockReservoirs next;
  for (auto more = merge.Next(next); more && *more; more = merge.Next(next)) blocks.push_back(next);
  return blocks;
}

bool Same(const Reservoir& a, const Reservoir& b) {
  return a.time == b.time && a.hash == b.hash && a.triangle == b.triangle && a.area == b.area &&
         a.local == b.local && a.barycentric[0] == b.barycentric[0] &&
         a.barycentric[1] == b.barycentric[1];
}

void ExpectSame(const std::vector<BlockReservoirs>& a, const std::vector<BlockReservoirs>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_TRUE(a[i].block == b[i].block);
    ASSERT_EQ(a[i].cells.size(), b[i].cells.size());
    for (std::size_t k = 0; k < a[i].cells.size(); ++k) {
      ASSERT_EQ(a[i].cells[k].offset, b[i].cells[k].offset);
      ASSERT_TRUE(Same(a[i].cells[k].reservoir, b[i].cells[k].reservoir));
    }
  }
}

void AddCounts(const SampleStats& more, SampleStats& sum) {
  sum.read.vertices += more.read.vertices;
  sum.read.faces += more.read.faces;
  sum.read.triangles += more.read.triangles;
  for (std::size_t r = 0; r < sum.skipped.size(); ++r) {
    sum.read.skipped[r] += more.read.skipped[r];
    sum.skipped[r] += more.skipped[r];
  }
  sum.sampled += more.sampled;
  sum.pieces += more.pieces;
  sum.mesh_area += more.mesh_area;
}

void ExpectSameCounts(const SampleStats& a, const SampleStats& b) {
  EXPECT_EQ(a.read.vertices, b.read.vertices);
  EXPECT_EQ(a.read.faces, b.read.faces);
  EXPECT_EQ(a.read.triangles, b.read.triangles);
  EXPECT_EQ(a.read.skipped, b.read.skipped);
  EXPECT_EQ(a.skipped, b.skipped);
  EXPECT_EQ(a.sampled, b.sampled);
  EXPECT_EQ(a.pieces, b.pieces);
  EXPECT_NEAR(a.mesh_area, b.mesh_area, 1e-12 * std::abs(b.mesh_area));
}

// `keep_reader`: all shares through one reader, one after the other.
void ExpectSharesMakeTheWhole(const std::string& bytes, const LatticeSpec& lattice,
                              bool keep_reader) {
  std::vector<ScannedMesh> whole;
  whole.push_back(MustScan(*MustOpen(bytes), lattice, {}));
  const auto expected = Merged(whole);
  for (const std::uint32_t count : kCounts) {
    SCOPED_TRACE(std::to_string(count) + " shares");
    std::vector<ScannedMesh> parts;
    SampleStats sum;
    auto reader = MustOpen(bytes);
    for (std::uint32_t index = 0; index < count; ++index) {
      if (!keep_reader) reader = MustOpen(bytes);
      ASSERT_TRUE(reader->Rewind());
      parts.push_back(MustScan(*reader, lattice, {index, count}));
      const SampleStats& stats = parts.back().stats;
      EXPECT_TRUE(stats.lattice.origin == whole[0].stats.lattice.origin);
      EXPECT_EQ(stats.lattice.edge, whole[0].stats.lattice.edge);
      AddCounts(stats, sum);
    }
    ExpectSame(Merged(parts), expected);
    ExpectSameCounts(sum, whole[0].stats);
  }
}

TEST(ShareScan, LeavesTogetherWhatOneScanLeaves) {
  const std::string ply = SoupBytes(Sphere(), "binary_little_endian");
  for (const LatticeSpec& lattice :
       {LatticeSpec(Resolution{30}), LatticeSpec(Height{5}), LatticeSpec(VoxelSize{0.07})}) {
    for (const bool keep_reader : {false, true}) {
      ExpectSharesMakeTheWhole(ply, lattice, keep_reader);
    }
  }
}

TEST(ShareScan, LeavesTheSameWhereTheReaderCannotPassOverTheOthers) {
  for (const bool keep_reader : {false, true}) {
    ExpectSharesMakeTheWhole(SoupBytes(Sphere(), "obj"), Resolution{30}, keep_reader);
  }
  const std::string packed = Gzip(SoupBytes(Sphere(), "binary_big_endian"));
  ExpectSharesMakeTheWhole(packed, Resolution{30}, false);
}

TEST(ShareScan, OfAShareWithoutTrianglesLeavesNothing) {
  const std::string bytes =
      SoupBytes(SphereSoup(2000, Order::kCoherent, false), "binary_little_endian");
  const ScannedMesh none = MustScan(*MustOpen(bytes), Resolution{30}, {1, 2});
  EXPECT_EQ(none.stats.read.triangles, 0u);
  EXPECT_EQ(none.stats.read.vertices, 0u) << "counted by share 0";
  EXPECT_EQ(none.stats.sampled, 0u);
  EXPECT_EQ(none.store->grid().size(), 0u);
}

}  // namespace
}  // namespace strata::test
