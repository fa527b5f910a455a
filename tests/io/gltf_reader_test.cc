#include "io/gltf_reader.h"

#include <gtest/gtest.h>
#include <meshoptimizer.h>
#include <sys/stat.h>

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "core/summarize_mesh.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/read_mesh.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::GltfMaker;
using test::ReadWhole;
using Json = GltfMaker::Json;
using Corners = std::array<Vec3, 3>;

const std::vector<float> kSquare = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};

Result<test::WholeMesh> Read(const std::string& bytes, const std::string& name = "memory.gltf",
                             std::size_t batch = 64) {
  return ReadWhole(OpenMesh(MemorySource(bytes, name)), batch);
}
test::WholeMesh MustRead(const std::string& bytes) {
  auto mesh = Read(bytes);
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? *mesh : test::WholeMesh{};
}
void ExpectError(const std::string& bytes, ErrorCode code, const std::string& part) {
  auto mesh = Read(bytes);
  ASSERT_FALSE(mesh) << "expected: " << part;
  EXPECT_EQ(mesh.error().code, code) << mesh.error().message;
  EXPECT_NE(mesh.error().message.find(part), std::string::npos) << mesh.error().message;
}

GltfMaker Square() {
  GltfMaker maker;
  const int positions = maker.Floats3(kSquare);
  maker.Primitive(positions, maker.Indices({0, 1, 2, 0, 2, 3}));
  return maker;
}

TEST(GltfReader, GivesTheFloatsOfTheFileAsTheyAre) {
  const std::vector<float> odd = {0.1f, -2e-30f, 3e10f, 1.0f / 3, 7, -0.0f, 1e-7f, 5.5f, 2};
  GltfMaker maker;
  maker.Primitive(maker.Floats3(odd));
  for (const std::string& bytes : {maker.Text(), maker.Glb(), test::Gzip(maker.Glb())}) {
    const auto mesh = MustRead(bytes);
    ASSERT_EQ(mesh.triangles.size(), 1u);
    for (std::size_t v = 0; v < 3; ++v) {
      for (int axis = 0; axis < 3; ++axis) {
        EXPECT_EQ(mesh.triangles[0][v][axis], odd[3 * v + static_cast<std::size_t>(axis)]);
      }
    }
  }
}

TEST(GltfReader, ReadsEveryModeThatHasTriangles) {
  const std::vector<float> p = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 2, 1, 0};
  const Vec3 v[5] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {2, 1, 0}};
  for (const bool indexed : {false, true}) {
    GltfMaker maker;
    const int positions = maker.Floats3(p);
    const int indices = indexed ? maker.Indices({0, 1, 2, 3, 4}) : -1;
    for (int mode = 0; mode <= 6; ++mode) maker.Primitive(positions, indices, mode);
    const auto mesh = MustRead(maker.Text());
    const std::vector<Corners> expected = {
        {v[0], v[1], v[2]},                                           // A list and a rest of two.
        {v[0], v[1], v[2]}, {v[1], v[3], v[2]}, {v[2], v[3], v[4]},   // A strip.
        {v[1], v[2], v[0]}, {v[2], v[3], v[0]}, {v[3], v[4], v[0]}};  // A fan.
    EXPECT_EQ(mesh.triangles, expected);
    EXPECT_EQ(mesh.ids, (std::vector<std::uint64_t>{0, 2, 3, 4, 5, 6, 7}));
    EXPECT_EQ(mesh.skipped(SkipReason::kTooFewCorners), 1u);
    EXPECT_EQ(mesh.counts.triangles, 8u);
    EXPECT_EQ(mesh.counts.vertices, 5u);
    const auto& passed = mesh.info.contents.passed_over;
    EXPECT_EQ(passed, (std::vector<std::pair<std::string, std::uint64_t>>{
                          {"lines primitives", 3}, {"points primitives", 1}}));
  }
}

TEST(GltfReader, CountsCornersThatNameNoVertex) {
  GltfMaker maker;
  maker.Primitive(maker.Floats3(kSquare), maker.Indices({0, 1, 2, 0, 2, 65535}));
  const auto mesh = MustRead(maker.Text());
  EXPECT_EQ(mesh.triangles.size(), 1u);
  EXPECT_EQ(mesh.skipped(SkipReason::kIndexOutOfRange), 1u);
}

TEST(GltfReader, PlacesMeshesByMatrixAndByParts) {
  GltfMaker maker = Square();
  maker.json["nodes"] = {
      {{"children", {1, 2}}, {"translation", {10, 0, 0}}},
      {{"mesh", 0}, {"scale", {2, 3, 4}}, {"rotation", {0, 0, std::sqrt(0.5), std::sqrt(0.5)}}},
      {{"mesh", 0}, {"matrix", {1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 5, 6, 7, 1}}}};
  const auto mesh = MustRead(maker.Text());
  ASSERT_EQ(mesh.triangles.size(), 4u);
  // (1, 1, 0) times the scale is (2, 3, 0), turned a quarter (-3, 2, 0).
  const Vec3 turned = mesh.triangles[0][2];
  EXPECT_NEAR(turned.x, 7, 1e-14);
  EXPECT_NEAR(turned.y, 2, 1e-14);
  EXPECT_EQ(mesh.triangles[2][2], (Vec3{16, 6, 8}));
  EXPECT_EQ(mesh.info.contents.instances, 2u);
}

TEST(GltfReader, TurnsMirroredMeshesOutsideOut) {
  GltfMaker maker = Square();
  maker.json["nodes"][0]["scale"] = {-1, 1, 1};
  const auto mesh = MustRead(maker.Text());
  const auto& [a, b, c] = mesh.triangles[0];
  EXPECT_GT(Cross(b - a, c - a).z, 0);
  EXPECT_EQ(b, (Vec3{-1, 1, 0}));
}

TEST(GltfReader, ReadsQuantisedNormalisedAndStridedPositions) {
  GltfMaker maker;
  maker.json["extensionsRequired"] = {"KHR_mesh_quantization"};
  const std::vector<std::int8_t> bytes = {0, 0, 0, 9, 127, 0, 0, 9, -127, -128, 64, 9};
  Json accessor = {{"bufferView", maker.View(bytes, 4)},
                   {"componentType", 5120},
                   {"count", 3},
                   {"type", "VEC3"},
                   {"normalized", true}};
  maker.Primitive(maker.Accessor(accessor));
  accessor["normalized"] = false;
  maker.Primitive(maker.Accessor(accessor));
  const std::vector<std::uint16_t> words = {7, 7, 0, 0, 0, 7, 7, 65535, 0, 0, 7, 7, 0, 65535, 1};
  maker.Primitive(maker.Accessor({{"bufferView", maker.View(words, 10)},
                                  {"byteOffset", 4},
                                  {"componentType", 5123},
                                  {"count", 3},
                                  {"type", "VEC3"},
                                  {"normalized", true}}));
  const auto mesh = MustRead(maker.Text());
  ASSERT_EQ(mesh.triangles.size(), 3u);
  EXPECT_EQ(mesh.triangles[0][2], (Vec3{-1, -1, 64.0 / 127}));
  EXPECT_EQ(mesh.triangles[1][2], (Vec3{-127, -128, 64}));
  EXPECT_EQ(mesh.triangles[2], (Corners{Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{0, 1, 1.0 / 65535}}));
}

TEST(GltfReader, PutsSparseValuesInTheirPlaces) {
  GltfMaker maker;
  const std::vector<float> flat(9, 0.0f);
  const int indices = maker.View(std::vector<std::uint8_t>{1, 2});
  const int values = maker.View(std::vector<float>{1, 0, 0, 0, 1, 0});
  const Json sparse = {{"count", 2},
                       {"indices", {{"bufferView", indices}, {"componentType", 5121}}},
                       {"values", {{"bufferView", values}}}};
  Json accessor = {{"componentType", 5126}, {"count", 3}, {"type", "VEC3"}, {"sparse", sparse}};
  maker.Primitive(maker.Accessor(accessor));
  accessor["bufferView"] = maker.View(flat);
  maker.Primitive(maker.Accessor(accessor));
  const auto mesh = MustRead(maker.Text());
  ASSERT_EQ(mesh.triangles.size(), 2u);
  EXPECT_EQ(mesh.triangles[0], (Corners{Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{0, 1, 0}}));
  EXPECT_EQ(mesh.triangles[0], mesh.triangles[1]);
}

TEST(GltfReader, RepeatsAMeshForEveryInstance) {
  GltfMaker maker = Square();
  const int t = maker.Floats3({0, 0, 0, 0, 0, 5, 0, 0, 10});
  const int s = maker.Floats3({1, 1, 1, 2, 2, 2, -1, 1, 1});
  maker.json["nodes"][0]["translation"] = {100, 0, 0};
  maker.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"TRANSLATION", t}, {"SCALE", s}};
  maker.json["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
  for (const std::size_t batch : {1, 2, 5, 64}) {
    auto mesh = Read(maker.Text(), "memory", batch);
    ASSERT_TRUE(mesh) << mesh.error().message;
    ASSERT_EQ(mesh->triangles.size(), 6u);
    EXPECT_EQ(mesh->triangles[2][2], (Vec3{102, 2, 5}));
    EXPECT_EQ(mesh->triangles[4][1], (Vec3{99, 1, 10})) << "mirrored, so the second corner is last";
    EXPECT_EQ(mesh->info.contents.instances, 3u);
  }
}

TEST(GltfReader, NeedsOneMeshOfMemoryForAThousandInstances) {
  const auto memory_for = [](int instances) {
    GltfMaker maker;
    std::vector<float> soup(9 * 2000);
    for (std::size_t i = 0; i < soup.size(); ++i) soup[i] = static_cast<float>(i % 97);
    maker.Primitive(maker.Floats3(soup));
    maker.json["nodes"] = Json::array();
    for (int i = 0; i < instances; ++i) {
      maker.json["nodes"].push_back({{"mesh", 0}, {"translation", {i, 0, 0}}});
      maker.json["scenes"][0]["nodes"][static_cast<std::size_t>(i)] = i;
    }
    MemoryAccount account(std::uint64_t{1} << 30);
    OpenOptions options;
    options.memory = &account;
    auto reader = OpenMesh(MemorySource(maker.Glb()), options);
    EXPECT_TRUE(reader) << reader.error().message;
    TriangleBatch batch(1000);
    std::uint64_t most = 0, triangles = 0;
    while (*(*reader)->Read(batch) > 0) {
      most = std::max(most, account.taken());
      triangles += batch.size();
    }
    EXPECT_EQ(triangles, 2000u * static_cast<unsigned>(instances));
    return most;
  };
  // The nodes themselves are JSON.
  EXPECT_LT(memory_for(1000), memory_for(1) + 1000 * 2000);
}

TEST(GltfReader, MovesVerticesToTheRestPoseOfMorphTargets) {
  GltfMaker maker;
  Json& primitive = maker.Primitive(maker.Floats3({0, 0, 0, 1, 0, 0, 0, 1, 0}));
  const int move = maker.Floats3({0, 0, 4, 0, 0, 4, 0, 0, 4});
  const int other = maker.Floats3({8, 0, 0, 8, 0, 0, 8, 0, 0});
  maker.json["meshes"][0]["primitives"][0]["targets"] = {{{"POSITION", move}},
                                                         {{"POSITION", other}}};
  static_cast<void>(primitive);
  EXPECT_EQ(MustRead(maker.Text()).triangles[0][0], (Vec3{0, 0, 0}));
  maker.json["meshes"][0]["weights"] = {0.5, 0};
  EXPECT_EQ(MustRead(maker.Text()).triangles[0][0], (Vec3{0, 0, 2}));
  maker.json["nodes"][0]["weights"] = {0.25, 1};
  EXPECT_EQ(MustRead(maker.Text()).triangles[0][0], (Vec3{8, 0, 1}));
}

TEST(GltfReader, PutsSkinnedVerticesWhereTheirJointsAre) {
  GltfMaker maker;
  maker.Primitive(maker.Floats3({0, 0, 0, 1, 0, 0, 0, 1, 0}));
  const int joints =
      maker.Values(std::vector<std::uint8_t>{0, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0}, "VEC4", 4, 5121);
  const int weights = maker.Values(
      std::vector<std::uint8_t>{255, 0, 0, 0, 255, 0, 0, 0, 100, 100, 0, 0}, "VEC4", 4, 5121, true);
  std::vector<float> bind(32, 0.0f);
  for (const std::size_t i : {0, 5, 10, 15, 16, 21, 26, 31}) bind[i] = 1;
  bind[16 + 12] = -1;  // The second joint was bound at (1, 0, 0).
  const int inverse = maker.Values(bind, "MAT4", 16, 5126);
  auto& attributes = maker.json["meshes"][0]["primitives"][0]["attributes"];
  attributes["JOINTS_0"] = joints;
  attributes["WEIGHTS_0"] = weights;
  maker.json["skins"] = {{{"joints", {1, 2}}, {"inverseBindMatrices", inverse}}};
  maker.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {1000, 0, 0}}},
                         {{"translation", {0, 0, 3}}, {"children", {2}}},
                         {{"translation", {1, 0, 0}}, {"scale", {2, 2, 2}}}};
  maker.json["scenes"][0]["nodes"] = {0, 1};
  const auto mesh = MustRead(maker.Text());
  ASSERT_EQ(mesh.triangles.size(), 1u);
  EXPECT_EQ(mesh.triangles[0][0], (Vec3{0, 0, 3})) << "the first joint's, not the node's";
  EXPECT_EQ(mesh.triangles[0][1], (Vec3{1, 0, 3})) << "the second joint's, at its own origin";
  // Half (0, 1, 3), half (0 - 1, 1, 0) * 2 + (1, 0, 3).
  EXPECT_NEAR(mesh.triangles[0][2].x, -0.5, 1e-15);
  EXPECT_NEAR(mesh.triangles[0][2].y, 1.5, 1e-15);
}

std::string MeshoptSquare(bool damaged) {
  GltfMaker maker;
  const std::vector<std::uint16_t> positions = {0, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0};
  std::vector<unsigned char> packed(meshopt_encodeVertexBufferBound(4, 8));
  packed.resize(meshopt_encodeVertexBuffer(packed.data(), packed.size(), positions.data(), 4, 8));
  if (damaged) packed[0] ^= 0xff;
  const std::vector<unsigned> corners = {0, 1, 2, 0, 2, 3};
  std::vector<unsigned char> list(meshopt_encodeIndexBufferBound(6, 4));
  list.resize(meshopt_encodeIndexBuffer(list.data(), list.size(), corners.data(), 6));
  std::vector<unsigned char> sequence(meshopt_encodeIndexSequenceBound(6, 4));
  sequence.resize(meshopt_encodeIndexSequence(sequence.data(), sequence.size(), corners.data(), 6));
  const auto compressed = [&](const auto& bytes, int stride, int count, const char* mode) {
    const int view = maker.View(bytes);
    Json extension = maker.json["bufferViews"][static_cast<std::size_t>(view)];
    extension["byteStride"] = stride;
    extension["count"] = count;
    extension["mode"] = mode;
    // What a reader without the extension would take; there is nothing.
    Json placed = Json::object();
    placed["buffer"] = 0;
    placed["byteLength"] = stride * count;
    placed["extensions"]["EXT_meshopt_compression"] = std::move(extension);
    if (std::string(mode) == "ATTRIBUTES") placed["byteStride"] = stride;
    maker.json["bufferViews"][static_cast<std::size_t>(view)] = std::move(placed);
    return view;
  };
  const int vertices = compressed(packed, 8, 4, "ATTRIBUTES");
  const int triangles = compressed(list, 2, 6, "TRIANGLES");
  const int indices = compressed(sequence, 4, 6, "INDICES");
  const int p = maker.Accessor(
      {{"bufferView", vertices}, {"componentType", 5123}, {"count", 4}, {"type", "VEC3"}});
  maker.Primitive(
      p,
      maker.Accessor(
          {{"bufferView", triangles}, {"componentType", 5123}, {"count", 6}, {"type", "SCALAR"}}));
  maker.Primitive(
      p, maker.Accessor(
             {{"bufferView", indices}, {"componentType", 5125}, {"count", 6}, {"type", "SCALAR"}}));
  maker.json["extensionsRequired"] = {"EXT_meshopt_compression", "KHR_mesh_quantization"};
  return maker.Glb();
}

TEST(GltfReader, DecodesMeshopt) {
  const auto mesh = MustRead(MeshoptSquare(false));
  ASSERT_EQ(mesh.triangles.size(), 4u);
  double area = 0;
  for (const auto& [a, b, c] : mesh.triangles) area += 0.5 * Norm(Cross(b - a, c - a));
  EXPECT_DOUBLE_EQ(area, 2);
  ExpectError(MeshoptSquare(true), ErrorCode::kCorruptInput, "EXT_meshopt_compression");
}

TEST(GltfReader, SaysByItsPointerWhatIsWrong) {
  const auto with = [](const std::string& pointer, const Json& value) {
    GltfMaker maker = Square();
    maker.json[Json::json_pointer(pointer)] = value;
    return maker.Text();
  };
  const auto corrupt = ErrorCode::kCorruptInput;
  ExpectError(with("/accessors/0/count", 5), corrupt, "/accessors/0: 5 elements");
  ExpectError(with("/accessors/0/count", -1), corrupt, "/accessors/0/count: found '-1'");
  ExpectError(with("/accessors/0/count", 4e15), corrupt, "/accessors/0/count");
  ExpectError(with("/accessors/0/componentType", 1), corrupt, "/accessors/0/componentType");
  ExpectError(with("/accessors/0/type", "VEC5"), corrupt, "/accessors/0/type: found 'VEC5'");
  ExpectError(with("/accessors/0/type", "VEC2"), corrupt, "/attributes/POSITION: expected VEC3");
  ExpectError(with("/bufferViews/0/byteLength", 1e9), corrupt,
              "/bufferViews/0: bytes 0 to 1000000000");
  ExpectError(with("/meshes/0/primitives/0/indices", 9), corrupt, "found index 9 of 2");
  ExpectError(with("/meshes/0/primitives/0/mode", 7), corrupt, "mode: found 7, expected at most 6");
  ExpectError(with("/nodes/0/children", {0}), corrupt, "/nodes/0: is its own descendant");
  ExpectError(with("/nodes/0/mesh", 3), corrupt, "/nodes/0/mesh: found index 3 of 1");
  ExpectError(with("/nodes/0/matrix", {1, 2}), corrupt, "/nodes/0/matrix: found 2 numbers");
  ExpectError(with("/scenes/0/nodes", {5}), corrupt, "/scenes/0/nodes/0");
  ExpectError(with("/asset/version", "1.0"), ErrorCode::kUnsupported, "glTF version '1.0'");
  ExpectError(with("/extensionsRequired", {"ACME_voxels"}), ErrorCode::kUnsupported, "ACME_voxels");
}

TEST(GltfReader, BoundsWhatAFileClaimsWithoutBytes) {
  GltfMaker maker = Square();
  maker.json["accessors"][0].erase("bufferView");
  maker.json["accessors"][0]["count"] = 1000000000;
  ExpectError(maker.Text(), ErrorCode::kOverBudget, "elements without bytes of their own");
  // 2^30 placings by thirty nodes, each the child of the one before, twice.
  GltfMaker doubling = Square();
  doubling.json["nodes"] = Json::array();
  for (int i = 0; i < 30; ++i) doubling.json["nodes"].push_back({{"children", {i + 1, i + 1}}});
  doubling.json["nodes"].push_back({{"mesh", 0}});
  ExpectError(doubling.Text(), ErrorCode::kOverBudget, "several parents");
  ExpectError("{\"asset\":" + std::string(100000, '['), ErrorCode::kCorruptInput, "nested deeper");
}

TEST(GltfReader, TakesAFileWithoutNodesAsItsMeshes) {
  GltfMaker maker = Square();
  for (const char* key : {"scene", "scenes", "nodes"}) maker.json.erase(key);
  EXPECT_EQ(MustRead(maker.Text()).triangles.size(), 2u);
}

TEST(GltfReader, OpensBuffersInItsFolderAndNowhereElse) {
  test::TempFolder folder;
  const GltfMaker maker = Square();
  std::filesystem::create_directories(folder / "in/sub");
  test::WriteFile(folder / "in/sub/a b.bin", maker.bin);
  test::WriteFile(folder / "secret.bin", maker.bin);
  std::filesystem::create_symlink("../secret.bin", folder / "in/link.bin");
  std::filesystem::create_symlink("sub/a b.bin", folder / "in/inside.bin");
  const auto open = [&](const std::string& uri) {
    test::WriteFile(folder / "in/mesh.gltf", maker.TextBeside(uri));
    return ReadWhole(OpenMesh(folder / "in/mesh.gltf"));
  };
  for (const char* good : {"sub/a%20b.bin", "sub/a b.bin", "inside.bin", "./sub//a b.bin"}) {
    auto mesh = open(good);
    ASSERT_TRUE(mesh) << good << ": " << mesh.error().message;
    EXPECT_EQ(mesh->triangles.size(), 2u);
  }
  for (const std::string& bad :
       {std::string("../secret.bin"), std::string("link.bin"), folder / "secret.bin",
        std::string("http://example.org/a.bin"), std::string("file:///etc/passwd"),
        std::string("%2e%2e/secret.bin"), std::string("sub/..%2f..%2fsecret.bin"),
        std::string("sub\\a b.bin"), std::string("sub"), std::string("//host/share")}) {
    auto mesh = open(bad);
    ASSERT_FALSE(mesh) << bad;
    EXPECT_EQ(mesh.error().code, ErrorCode::kUnsupported) << mesh.error().message;
    EXPECT_NE(mesh.error().message.find("/buffers/0/uri"), std::string::npos);
  }
  auto missing = open("nothing.bin");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound) << missing.error().message;
  ExpectError(maker.TextBeside("sub/a b.bin"), ErrorCode::kUnsupported, "has no folder");
  ASSERT_EQ(mkfifo((folder / "in/pipe.bin").c_str(), 0600), 0);
  EXPECT_EQ(open("pipe.bin").error().code, ErrorCode::kUnsupported);
}

TEST(GltfReader, RejectsEveryPrefix) {
  GltfMaker maker = Square();
  for (const std::string& bytes : {maker.Text(), maker.Glb(), MeshoptSquare(false)}) {
    // "g" alone is an OBJ file.
    for (std::size_t n = bytes[0] == 'g' ? 4 : 0; n < bytes.size(); ++n) {
      auto mesh = Read(bytes.substr(0, n));
      ASSERT_FALSE(mesh) << "a prefix of " << n << " bytes";
      EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << n << ": " << mesh.error().message;
    }
  }
}

TEST(GltfReader, GivesEachShareItsBlocksAndTheSameAfterRewind) {
  GltfMaker maker;
  std::vector<float> soup(9 * 50'000);
  for (std::size_t i = 0; i < soup.size(); ++i) soup[i] = static_cast<float>((i * 7919) % 1013);
  maker.Primitive(maker.Floats3(soup));
  maker.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"scale", {2, 2, 2}}}, {{"mesh", 0}}};
  maker.json["scenes"][0]["nodes"] = {0, 1, 2};
  auto reader = OpenMesh(MemorySource(maker.Glb()));
  ASSERT_TRUE(reader) << reader.error().message;
  const auto whole = ReadWhole(**reader, 4096);
  ASSERT_TRUE(whole);
  ASSERT_EQ(whole->triangles.size(), 150'000u);
  ReadCounts sum;
  std::uint64_t seen = 0;
  for (std::uint32_t index = 0; index < 2; ++index) {
    ASSERT_TRUE((*reader)->SelectShare({index, 2, 0}));
    ASSERT_TRUE((*reader)->Rewind());
    const auto part = ReadWhole(**reader, 1000);
    ASSERT_TRUE(part);
    for (std::size_t i = 0; i < part->ids.size(); ++i) {
      ASSERT_TRUE((Share{index, 2, 0}).Holds(part->ids[i]));
      ASSERT_EQ(part->triangles[i], whole->triangles[part->ids[i]]);
    }
    seen += part->ids.size();
    sum.Add(part->counts);
  }
  EXPECT_EQ(seen, whole->triangles.size());
  EXPECT_EQ(sum.triangles, whole->counts.triangles);
  EXPECT_EQ(sum.vertices, whole->counts.vertices);
}

TEST(GltfReader, KeepsVerticesBeyondTheBudgetInScratchSpace) {
  GltfMaker maker;
  std::vector<float> points;
  std::vector<std::uint32_t> corners;
  for (int i = 0; i < 60'000; ++i) {
    points.insert(points.end(), {static_cast<float>(i % 251), static_cast<float>(i), 1});
    for (const int k : {0, 1, 2})
      corners.push_back(static_cast<std::uint32_t>((i * 7 + k * 31) % 60'000));
  }
  maker.Primitive(maker.Floats3(points), maker.Values(corners, "SCALAR", 1, 5125));
  maker.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"translation", {0, 0, 9}}}};
  maker.json["scenes"][0]["nodes"] = {0, 1};
  const auto near = Read(maker.Glb());
  ASSERT_TRUE(near);
  const auto folder = ScratchFolder::OpenSystems();
  ASSERT_TRUE(folder);
  OpenOptions options;
  options.scratch = folder->get();
  options.vertex_budget = 200'000;
  auto reader = OpenMesh(MemorySource(maker.Glb()), options);
  ASSERT_TRUE(reader) << reader.error().message;
  for (int pass = 0; pass < 2; ++pass) {
    const auto far = ReadWhole(**reader, 1000);
    ASSERT_TRUE(far) << far.error().message;
    EXPECT_EQ(far->triangles, near->triangles);
    EXPECT_EQ(far->ids, near->ids);
    ASSERT_TRUE((*reader)->Rewind());
  }
}

}  // namespace
}  // namespace strata::io
