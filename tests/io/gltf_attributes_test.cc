#include "io/gltf_attributes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/attribute_values.h"
#include "tests/support/gltf_maker.h"

namespace strata::io {
namespace {

using test::GltfMaker;
using Json = GltfMaker::Json;

using test::NumberOf;
using test::ValuesAt;

// Two triangles of a square with everything, the second node a mirror image moved away.
GltfMaker Full() {
  GltfMaker maker;
  const int positions = maker.Floats3({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0});
  const int indices = maker.Indices({0, 1, 2, 0, 2, 3});
  const int colors = maker.Values(
      std::vector<std::uint8_t>{0, 0, 0, 255, 255, 0, 0, 255, 255, 255, 0, 255, 0, 255, 0, 255},
      "VEC4", 4, 5121, true);
  const int uvs = maker.Values(std::vector<float>{0, 0, 1, 0, 1, 1, 0, 1}, "VEC2", 2, 5126);
  const int labels = maker.Values(std::vector<std::uint16_t>{7, 300, 65535, 0}, "SCALAR", 1, 5123);
  const int normals = maker.Floats3({1, 0, 1, 1, 0, 1, 1, 0, 1, 1, 0, 1});
  Json& primitive = maker.Primitive(positions, indices);
  primitive["attributes"]["COLOR_0"] = colors;
  primitive["attributes"]["TEXCOORD_1"] = uvs;
  primitive["attributes"]["_LABEL"] = labels;
  primitive["attributes"]["NORMAL"] = normals;
  primitive["material"] = 1;
  maker.Primitive(positions, indices);
  maker.json["meshes"][0]["name"] = "square";
  maker.json["materials"] = {{{"name", "red"}}, {{"name", "blue"}}};
  maker.json["nodes"] = {{{"mesh", 0}, {"name", "here"}},
                         {{"mesh", 0}, {"name", "there"}, {"scale", {-2, 1, 1}}}};
  maker.json["scenes"][0]["nodes"] = {0, 1};
  return maker;
}

const SurfacePoint kMiddle{0, {0.25, 0.25, 0.5}};

std::unique_ptr<MeshReader> Open(const std::string& bytes) {
  auto reader = OpenMesh(MemorySource(bytes));
  EXPECT_TRUE(reader) << reader.error().message;
  return std::move(*reader);
}

TEST(GltfAttributes, AreListedWithTheirTypesAndMeanings) {
  const auto reader = Open(Full().Glb());
  const auto at = [&](const char* name) { return reader->attributes()[NumberOf(*reader, name)]; };
  EXPECT_EQ(at("color").components, 4);
  EXPECT_EQ(at("color").color_space, ColorSpace::kLinear);
  EXPECT_EQ(at("uv_1").set, 1);
  EXPECT_EQ(at("_LABEL").type, ScalarType::kUint16);
  EXPECT_EQ(at("_LABEL").carry, Carry::kNearestCorner);
  EXPECT_EQ(at("material").names, (std::vector<std::string>{"red", "blue"}));
  EXPECT_EQ(at("mesh").names, std::vector<std::string>{"square"});
  EXPECT_EQ(at("node").names, (std::vector<std::string>{"here", "there"}));
  EXPECT_EQ(at("mesh_normal").semantic, Semantic::kNormal);
}

TEST(GltfAttributes, AreInterpolatedAndLabelsAreNot) {
  const auto reader = Open(Full().Glb());
  EXPECT_EQ(ValuesAt<float>(*reader, "color", {kMiddle}), (std::vector<float>{0.75f, 0.5f, 0, 1}));
  EXPECT_EQ(ValuesAt<float>(*reader, "uv_1", {kMiddle}), (std::vector<float>{0.75f, 0.5f}));
  EXPECT_EQ(ValuesAt<std::uint16_t>(*reader, "_LABEL", {kMiddle}),
            std::vector<std::uint16_t>{65535});
}

TEST(GltfAttributes, OfPrimitivesWithoutThemAreWhatTheSpecificationSays) {
  const auto reader = Open(Full().Glb());
  // Triangles 0 to 3: the first primitive, placed twice; 4 to 7: the second.
  const SurfacePoint bare{4, {0.25, 0.25, 0.5}}, mirrored{6, {0.25, 0.25, 0.5}};
  EXPECT_EQ(ValuesAt<float>(*reader, "color", {bare}), (std::vector<float>{1, 1, 1, 1}));
  EXPECT_TRUE(std::isnan(ValuesAt<float>(*reader, "uv_1", {bare})[0]));
  EXPECT_EQ(ValuesAt<float>(*reader, "mesh_normal", {bare, mirrored}),
            (std::vector<float>{0, 0, 1, 0, 0, 1}));
  EXPECT_EQ(ValuesAt<std::uint32_t>(*reader, "material", {kMiddle, bare}),
            (std::vector<std::uint32_t>{1, UINT32_MAX}));
}

TEST(GltfAttributes, FollowTheMirroredCornersAndTurnNormals) {
  const auto reader = Open(Full().Glb());
  TriangleBatch batch(16);
  ASSERT_EQ(*reader->Read(batch), 8u);
  // At each corner of triangle 2 the texture coordinates are x / -2 and y.
  for (std::size_t v = 0; v < 3; ++v) {
    SurfacePoint corner{2, {}};
    corner.weight[v] = 1;
    const Vec3 p = batch.corner(2, static_cast<int>(v));
    const auto uv = ValuesAt<float>(*reader, "uv_1", {corner});
    EXPECT_EQ(uv[0], p.x / -2) << v;
    EXPECT_EQ(uv[1], p.y) << v;
  }
  // (1, 0, 1) under a scale of -2 in x: (-1/2, 0, 1), of the length it had.
  const auto n = ValuesAt<float>(*reader, "mesh_normal", {{2, {1, 0, 0}}});
  EXPECT_NEAR(n[0] / n[2], -0.5, 1e-6);
  EXPECT_GT(n[2], 0);
  EXPECT_EQ(ValuesAt<std::uint32_t>(*reader, "node", {kMiddle, {2, {1, 0, 0}}}),
            (std::vector<std::uint32_t>{0, 1}));
}

TEST(GltfAttributes, TellInstancesApart) {
  GltfMaker maker = Full();
  maker.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] =
      maker.Floats3({0, 0, 0, 5, 0, 0});
  const auto reader = Open(maker.Glb());
  EXPECT_EQ(ValuesAt<std::uint32_t>(*reader, "instance", {kMiddle, {2, {1, 0, 0}}}),
            (std::vector<std::uint32_t>{0, 1}));
}

// A triangle in the plane z = 0 with normals along (3, 0, 4).
GltfMaker Leaning() {
  GltfMaker maker;
  maker.Primitive(maker.Floats3({0, 0, 0, 1, 0, 0, 0, 1, 0}))["attributes"]["NORMAL"] =
      maker.Floats3({3, 0, 4, 3, 0, 4, 3, 0, 4});
  return maker;
}

const std::vector<SurfacePoint> kCentre = {{0, {0.5, 0.25, 0.25}}};

TEST(GltfNormals, HaveTheirMorphTargetsAdded) {
  GltfMaker maker = Leaning();
  auto& primitive = maker.json["meshes"][0]["primitives"][0];
  primitive["targets"] = {{{"NORMAL", maker.Floats3({-3, 8, 0, -3, 8, 0, -3, 8, 0})}},
                          {{"POSITION", maker.Floats3({0, 0, 5, 0, 0, 5, 0, 0, 5})}}};
  maker.json["meshes"][0]["weights"] = {0.5, 1};
  EXPECT_EQ(ValuesAt<float>(*Open(maker.Glb()), "mesh_normal", kCentre),
            (std::vector<float>{1.5f, 4, 4}));
  // A node's weights come before the mesh's.
  maker.json["nodes"][0]["weights"] = {1, 0};
  EXPECT_EQ(ValuesAt<float>(*Open(maker.Glb()), "mesh_normal", kCentre),
            (std::vector<float>{0, 8, 4}));
}

TEST(GltfNormals, AreTurnedByTheJointsOfASkin) {
  GltfMaker maker = Leaning();
  auto& attributes = maker.json["meshes"][0]["primitives"][0]["attributes"];
  attributes["JOINTS_0"] =
      maker.Values(std::vector<std::uint8_t>{0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}, "VEC4", 4, 5121);
  attributes["WEIGHTS_0"] = maker.Values(
      std::vector<float>{0.5f, 0.5f, 0, 0, 0.5f, 0.5f, 0, 0, 0.5f, 0.5f, 0, 0}, "VEC4", 4, 5126);
  maker.json["skins"] = {{{"joints", {1, 2}}}};
  maker.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {7, 7, 7}}},
                         {{"scale", {1, 1, 1}}},
                         {{"scale", {3, 1, 1}}}};
  maker.json["scenes"][0]["nodes"] = {0, 1, 2};
  // Both joints together stretch x by 2: (3 / 2, 0, 4), of the length that it had.
  const double factor = 5 / std::sqrt(1.5 * 1.5 + 16);
  const auto stretched = ValuesAt<float>(*Open(maker.Glb()), "mesh_normal", kCentre);
  EXPECT_NEAR(stretched[0], 1.5 * factor, 1e-6);
  EXPECT_EQ(stretched[1], 0);
  EXPECT_NEAR(stretched[2], 4 * factor, 1e-6);
  // A quarter turn about x takes z to -y.
  const double half = std::sqrt(0.5);
  for (const std::size_t joint : {1u, 2u}) {
    maker.json["nodes"][joint] = {{"rotation", {half, 0, 0, half}}};
  }
  const auto turned = ValuesAt<float>(*Open(maker.Glb()), "mesh_normal", kCentre);
  EXPECT_NEAR(turned[0], 3, 1e-6);
  EXPECT_NEAR(turned[1], -4, 1e-6);
  EXPECT_NEAR(turned[2], 0, 1e-6);
}

TEST(GltfNormals, OfASphereStayItsOwnWhereMorphsAndJointsMoveIt) {
  // Points of a unit sphere as vertices: normals are the positions, before and after.
  GltfMaker maker;
  const std::vector<float> octant = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  maker.Primitive(maker.Floats3(octant))["attributes"]["NORMAL"] = maker.Floats3(octant);
  auto& attributes = maker.json["meshes"][0]["primitives"][0]["attributes"];
  attributes["JOINTS_0"] = maker.Values(std::vector<std::uint8_t>(12, 0), "VEC4", 4, 5121);
  attributes["WEIGHTS_0"] = maker.Values(
      std::vector<std::uint8_t>{255, 0, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0}, "VEC4", 4, 5121, true);
  maker.json["skins"] = {{{"joints", {1}}}};
  maker.json["nodes"] = {{{"mesh", 0}, {"skin", 0}},
                         {{"rotation", {0.1, 0.7, -0.5, 0.5}}, {"translation", {9, 9, 9}}}};
  maker.json["scenes"][0]["nodes"] = {0, 1};
  const auto reader = Open(maker.Glb());
  TriangleBatch batch(4);
  ASSERT_EQ(*reader->Read(batch), 1u);
  for (int v = 0; v < 3; ++v) {
    SurfacePoint corner{0, {}};
    corner.weight[static_cast<std::size_t>(v)] = 1;
    const auto n = ValuesAt<float>(*reader, "mesh_normal", {corner});
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(n[static_cast<std::size_t>(axis)], batch.corner(0, v)[axis] - 9, 1e-6);
    }
  }
}

}  // namespace
}  // namespace strata::io
