#include "io/drc_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "io/draco_header.h"
#include "io/open_mesh.h"
#include "tests/support/attribute_values.h"
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
  for (const std::string& bytes : {MakeDraco(4, false, true), MakeDraco(4, true, true),
                                   test::MakeFullDraco(false), test::MakeFullDraco(true)}) {
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

TEST(DrcReader, RefusesPositionsThatAreTruthValues) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(1);
  const int id = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_BOOL);
  const std::uint8_t a[3] = {0, 0, 0}, b[3] = {1, 0, 0}, c[3] = {0, 200, 0};
  builder.SetAttributeValuesForFace(id, draco::FaceIndex(0), a, b, c);
  draco::EncoderBuffer buffer;
  draco::Encoder encoder;
  encoder.SetEncodingMethod(draco::MESH_SEQUENTIAL_ENCODING);
  ASSERT_TRUE(encoder.EncodeMeshToBuffer(*builder.Finalize(), &buffer).ok());
  const auto mesh = Read({buffer.data(), buffer.size()});
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << mesh.error().message;
}

TEST(DrcAttributes, AreAllThatItsPointsCarry) {
  for (const bool edgebreaker : {false, true}) {
    SCOPED_TRACE(edgebreaker ? "edgebreaker" : "sequential");
    const auto opened = OpenMesh(MemorySource(test::MakeFullDraco(edgebreaker)));
    ASSERT_TRUE(opened) << opened.error().message;
    MeshReader& reader = **opened;
    EXPECT_EQ(
        Describe(reader.attributes()),
        "vertex_normal (3 x float32, vertex), color (4 x uint8, vertex), uv (2 x float32, "
        "vertex), uv_1 (2 x float32, vertex), label (int32, vertex), generic (int64, vertex), "
        "material (uint8, vertex)");
    const MeshAttribute& material = reader.attributes()[test::NumberOf(reader, "material")];
    EXPECT_EQ(material.names, (std::vector<std::string>{"oak", "ash"}));
    EXPECT_EQ(material.semantic, Semantic::kMaterial);
    TriangleBatch batch(4);
    ASSERT_EQ(*reader.Read(batch), 2u);
    std::vector<SurfacePoint> points;
    std::vector<Vec3> at, nearest;
    for (std::uint64_t t = 0; t < 2; ++t) {
      points.push_back({t, {0.25, 0.25, 0.5}});
      const Vec3 a = batch.corner(t, 0), b = batch.corner(t, 1), c = batch.corner(t, 2);
      at.push_back(a * 0.25 + b * 0.25 + c * 0.5);
      nearest.push_back(c);
    }
    const auto color = test::ValuesAt<std::uint8_t>(reader, "color", points);
    const auto uv = test::ValuesAt<float>(reader, "uv", points),
               uv1 = test::ValuesAt<float>(reader, "uv_1", points);
    const auto label = test::ValuesAt<std::int32_t>(reader, "label", points);
    const auto key = test::ValuesAt<std::int64_t>(reader, "generic", points);
    const auto ids = test::ValuesAt<std::uint8_t>(reader, "material", points);
    EXPECT_EQ(ids[0] + ids[1], 1);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_NEAR(color[4 * i], 255 * at[i].x, 0.51);
      EXPECT_NEAR(color[4 * i + 1], 255 * at[i].y, 0.51);
      EXPECT_EQ(color[4 * i + 2], 7);
      EXPECT_EQ(uv[2 * i], at[i].x);
      EXPECT_EQ(uv[2 * i + 1], at[i].y);
      EXPECT_EQ(uv1[2 * i], 1 - at[i].x);
      EXPECT_EQ(uv1[2 * i + 1], 5 + at[i].y);
      const bool x = nearest[i].x == 1, y = nearest[i].y == 1;
      EXPECT_EQ(label[i], x && y ? 12 : x ? 300007 : y ? 13 : -7);
      EXPECT_EQ(key[i], x && y ? 9007199254740993 : x ? 1 : y ? 2 : -1);
    }
    // Where the labels are: at every corner of both triangles.
    std::vector<SurfacePoint> corners;
    std::vector<std::int32_t> expected;
    for (std::uint64_t t = 0; t < 2; ++t) {
      for (std::size_t v = 0; v < 3; ++v) {
        corners.push_back({t, {}});
        corners.back().weight[v] = 1;
        const Vec3 p = batch.corner(t, static_cast<int>(v));
        expected.push_back(p.x == 1 ? (p.y == 1 ? 12 : 300007) : p.y == 1 ? 13 : -7);
      }
    }
    EXPECT_EQ(test::ValuesAt<std::int32_t>(reader, "label", corners), expected);
  }
}

TEST(DrcAttributes, TakeTheirMemoryFromTheAccountAndGiveItBack) {
  MemoryAccount enough(std::uint64_t{64} << 20);
  {
    OpenOptions options;
    options.memory = &enough;
    const auto reader = OpenMesh(MemorySource(test::MakeFullDraco(true)), options);
    ASSERT_TRUE(reader) << reader.error().message;
    const std::uint64_t opened = enough.taken();
    test::ValuesAt<float>(**reader, "uv", {{0, {1, 0, 0}}});
    EXPECT_EQ(enough.taken(), opened);
  }
  EXPECT_EQ(enough.taken(), 0u);
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
