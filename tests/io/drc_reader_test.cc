#include "io/drc_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "io/draco_header.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/draco_maker.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/read_mesh.h"

namespace strata::io {
namespace {

using test::ReadWhole;

using test::MakeDraco;

Result<test::WholeMesh> Read(const std::string& bytes, MemoryAccount* memory = nullptr) {
  OpenOptions options;
  options.memory = memory;
  return ReadWhole(OpenMesh(MemorySource(bytes), options), 7);
}

TEST(DrcReader, GivesTheFloatsThatWereEncoded) {
  for (const bool edgebreaker : {false, true}) {
    for (const bool metadata : {false, true}) {
      const std::string bytes = MakeDraco(10, edgebreaker, metadata);
      for (const std::string& stored : {bytes, test::Gzip(bytes)}) {
        auto mesh = Read(stored);
        ASSERT_TRUE(mesh) << mesh.error().message;
        EXPECT_EQ(mesh->triangles.size(), 20u);
        EXPECT_EQ(mesh->counts.vertices, 22u);
        EXPECT_EQ(mesh->info.format, "drc");
        double x = 0;
        for (const auto& triangle : mesh->triangles) {
          for (const Vec3 p : triangle) {
            EXPECT_EQ(p.z, 0.1f);
            x = std::max(x, p.x);
          }
        }
        EXPECT_EQ(x, 10);
      }
    }
  }
}

TEST(DrcReader, RejectsEveryPrefix) {
  for (const bool edgebreaker : {false, true}) {
    const std::string bytes = MakeDraco(4, edgebreaker, true);
    for (std::size_t n = 0; n + 1 < bytes.size(); ++n) {
      auto mesh = Read(bytes.substr(0, n));
      if (n < 5) {
        EXPECT_FALSE(mesh);
        continue;
      }
      ASSERT_FALSE(mesh) << "a prefix of " << n << " of " << bytes.size() << " bytes";
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
    }
  }
}

TEST(DrcReader, ChecksWhatTheHeadClaimsBeforeDecoding) {
  std::string bytes = MakeDraco(4, true);
  // Behind eleven bytes of head stand the kind of traversal, the vertices, the faces.
  bytes = bytes.substr(0, 12) + "\xff\xff\xff\x7f\xff\xff\xff\x7f" + bytes.substr(14);
  auto mesh = Read(bytes);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);
  EXPECT_NE(mesh.error().message.find("cannot hold 268435455 faces"), std::string::npos)
      << mesh.error().message;
}

TEST(DrcReader, TakesWhatDecodingNeedsFromTheAccount) {
  const std::string bytes = MakeDraco(20'000, true);
  MemoryAccount little(std::uint64_t{1} << 20);
  auto mesh = Read(bytes, &little);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kOverBudget) << mesh.error().message;
  MemoryAccount enough(std::uint64_t{64} << 20);
  EXPECT_TRUE(Read(bytes, &enough));
  EXPECT_EQ(enough.taken(), 0u);
}

TEST(DrcReader, RefusesPointCloudsAndLaterVersions) {
  std::string bytes = MakeDraco(1, false);
  bytes[7] = 0;
  EXPECT_NE(Read(bytes).error().message.find("point cloud"), std::string::npos);
  bytes = MakeDraco(1, false);
  bytes[6] = 9;
  EXPECT_EQ(Read(bytes).error().code, ErrorCode::kUnsupported);
}

TEST(GltfReader, DecodesDracoPrimitives) {
  const std::string bytes = MakeDraco(10, true);
  test::GltfMaker maker;
  const int view = maker.View(std::vector<char>(bytes.begin(), bytes.end()));
  const int positions = maker.Accessor({{"componentType", 5126}, {"count", 22}, {"type", "VEC3"}});
  const int indices = maker.Accessor({{"componentType", 5125}, {"count", 60}, {"type", "SCALAR"}});
  maker.Primitive(positions, indices)["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", view}, {"attributes", {{"POSITION", 0}}}};
  maker.json["extensionsRequired"] = {"KHR_draco_mesh_compression"};
  maker.json["nodes"][0]["scale"] = {2, 2, 2};
  auto mesh = Read(maker.Glb());
  ASSERT_TRUE(mesh) << mesh.error().message;
  ASSERT_EQ(mesh->triangles.size(), 20u);
  double area = 0;
  for (const auto& [a, b, c] : mesh->triangles) area += 0.5 * Norm(Cross(b - a, c - a));
  EXPECT_NEAR(area, 40, 1e-12);
  maker.json["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["attributes"]
            ["POSITION"] = 7;
  auto wrong = Read(maker.Glb());
  ASSERT_FALSE(wrong);
  EXPECT_NE(wrong.error().message.find("no such attribute"), std::string::npos);
}

}  // namespace
}  // namespace strata::io
