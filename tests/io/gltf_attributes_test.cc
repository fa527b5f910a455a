#include "io/gltf_attributes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/gltf_maker.h"

namespace strata::io {
namespace {

using test::GltfMaker;
using Json = GltfMaker::Json;

std::size_t NumberOf(const MeshReader& reader, const std::string& name) {
  const auto attributes = reader.attributes();
  for (std::size_t k = 0; k < attributes.size(); ++k) {
    if (attributes[k].name == name) return k;
  }
  ADD_FAILURE() << "no attribute " << name << " among " << Describe(attributes);
  return 0;
}

// The values of one attribute at these points, components one after the other.
template <class T>
std::vector<T> ValuesAt(MeshReader& reader, const std::string& name,
                        const std::vector<SurfacePoint>& points) {
  const std::size_t number[] = {NumberOf(reader, name)};
  const MeshAttribute& attribute = reader.attributes()[number[0]];
  EXPECT_EQ(attribute.bytes() % sizeof(T), 0u);
  RunContext context;
  auto pass = reader.ReadAttributes(number, context);
  EXPECT_TRUE(pass) << pass.error().message;
  std::vector<T> values(points.size() * static_cast<std::size_t>(attribute.components));
  char* const out[] = {reinterpret_cast<char*>(values.data())};
  const auto read = (*pass)->Read(points, out);
  EXPECT_TRUE(read) << read.error().message;
  return values;
}

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

}  // namespace
}  // namespace strata::io
