#include "tests/fuzz/mesh_seeds.h"

#include <cstdint>

#include "io/assimp_stream.h"
#include "tests/support/draco_maker.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/image_maker.h"
#include "tests/support/zip_maker.h"

using strata::test::GltfMaker;

namespace {

const std::vector<float> kSquare = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};

// Modes, instances, a sparse accessor, a morph target.
GltfMaker Various() {
  GltfMaker maker;
  const int positions = maker.Floats3(kSquare);
  const int indices = maker.Indices({0, 1, 2, 0, 2, 3});
  for (const int mode : {1, 4, 5, 6}) maker.Primitive(positions, indices, mode);
  const int at = maker.View(std::vector<std::uint8_t>{1, 2});
  const int values = maker.View(std::vector<float>{1, 0, 0, 0, 1, 0});
  maker.Primitive(maker.Accessor({{"componentType", 5126},
                                  {"count", 3},
                                  {"type", "VEC3"},
                                  {"sparse",
                                   {{"count", 2},
                                    {"indices", {{"bufferView", at}, {"componentType", 5121}}},
                                    {"values", {{"bufferView", values}}}}}}));
  maker.json["meshes"][0]["primitives"][1]["targets"] = {{{"POSITION", positions}}};
  maker.json["meshes"][0]["weights"] = {0.5};
  maker.json["nodes"] = {
      {{"mesh", 0}, {"scale", {-1, 2, 1}}, {"rotation", {0, 0, 0.6, 0.8}}, {"children", {1}}},
      {{"mesh", 0},
       {"matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1}},
       {"extensions",
        {{"EXT_mesh_gpu_instancing", {{"attributes", {{"TRANSLATION", positions}}}}}}}}};
  return maker;
}

GltfMaker Skinned() {
  GltfMaker maker;
  auto& attributes = maker.Primitive(maker.Floats3({0, 0, 0, 1, 0, 0, 0, 1, 0}))["attributes"];
  attributes["JOINTS_0"] =
      maker.Values(std::vector<std::uint8_t>{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}, "VEC4", 4, 5121);
  attributes["WEIGHTS_0"] = maker.Values(
      std::vector<std::uint8_t>{255, 0, 0, 0, 255, 0, 0, 0, 9, 0, 0, 0}, "VEC4", 4, 5121, true);
  attributes["NORMAL"] = maker.Floats3({0, 0, 1, 0, 1, 0, 1, 0, 0});
  maker.json["meshes"][0]["primitives"][0]["targets"] = {{{"NORMAL", attributes["NORMAL"]}}};
  maker.json["meshes"][0]["weights"] = {2};
  maker.json["skins"] = {{{"joints", {0}}}};
  maker.json["nodes"][0]["skin"] = 0;
  return maker;
}

GltfMaker Packed() {
  GltfMaker maker;
  const std::string bytes = strata::test::MakeDraco(2, true);
  const int view = maker.View(std::vector<char>(bytes.begin(), bytes.end()));
  const int positions = maker.Accessor({{"componentType", 5126}, {"count", 6}, {"type", "VEC3"}});
  maker.Primitive(positions)["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", view}, {"attributes", {{"POSITION", 0}}}};
  return maker;
}

// A texture in a view, with a sampler and a transform; a material without; a damaged one.
GltfMaker Textured() {
  GltfMaker maker;
  const int positions = maker.Floats3(kSquare), indices = maker.Indices({0, 1, 2, 0, 2, 3});
  const int uvs = maker.Values(std::vector<float>{0, 0, 2, 0, 2, 3, 0, 3}, "VEC2", 2, 5126);
  const std::string image = strata::test::MakePng(strata::test::MakePixels(
      3, 2, 3, [](unsigned x, unsigned y, int c) { return x * 80 + y * 40 + c * 7u; }));
  const int view = maker.View(std::vector<char>(image.begin(), image.end()));
  for (int k = 0; k < 2; ++k) {
    auto& primitive = maker.Primitive(positions, indices);
    primitive["attributes"]["TEXCOORD_0"] = uvs;
    primitive["material"] = k;
  }
  const GltfMaker::Json texture = {
      {"index", 0},
      {"extensions", {{"KHR_texture_transform", {{"rotation", 1}, {"scale", {2, -1}}}}}}};
  maker.json["materials"] = {
      {{"pbrMetallicRoughness", {{"baseColorTexture", texture}}}},
      {{"alphaMode", "BLEND"}, {"pbrMetallicRoughness", {{"baseColorFactor", {1, 0.5, 0, 0.5}}}}}};
  maker.json["samplers"] = {{{"wrapS", 33648}, {"magFilter", 9728}}};
  maker.json["textures"] = {{{"source", 0}, {"sampler", 0}}};
  maker.json["images"] = {{{"bufferView", view}, {"mimeType", "image/png"}}};
  return maker;
}

}  // namespace

std::vector<std::string> GltfSeeds() {
  std::vector<std::string> seeds;
  for (const GltfMaker& maker : {Various(), Skinned(), Packed(), Textured()}) {
    seeds.push_back(maker.Text());
    seeds.push_back(maker.Glb());
  }
  return seeds;
}

std::vector<std::string> DracoSeeds() {
  return {strata::test::MakeDraco(3, true), strata::test::MakeDraco(3, false, true),
          strata::test::MakeFullDraco(true), strata::test::MakeFullDraco(false)};
}

std::vector<std::string> ArchiveSeeds() {
  using strata::test::ModelTag;
  return {
      strata::test::MakeZip({{"a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"}, {"b.txt", "b"}}),
      strata::test::Make3mf(ModelTag() + "<resources>" + strata::test::Tetrahedron(1) +
                            "<object id=\"2\"><components><component objectid=\"1\" "
                            "transform=\"0 1 0 -1 0 0 0 0 1 9 9 9\"/></components></object>"
                            "</resources><build><item objectid=\"2\"/></build></model>")};
}

std::vector<std::string> ThreeMfSeeds() {
  using strata::test::ModelTag;
  const std::string materials =
      "xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\" unit=\"inch\"";
  const std::string facet =
      "<mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/>"
      "<vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles><triangle v1=\"0\" v2=\"1\" v3=\"2\" "
      "pid=\"2\" p1=\"0\" p2=\"1\"/><triangle v1=\"0\" v2=\"2\" v3=\"1\" pid=\"3\" p1=\"0\"/>"
      "<triangle v1=\"0\" v2=\"2\" v3=\"9\"/></triangles></mesh></object>";
  return {ModelTag(materials) +
              "<resources><basematerials id=\"1\"><base name=\"a\" displaycolor=\"#804000\"/>"
              "</basematerials><m:colorgroup id=\"2\"><m:color color=\"#FF000080\"/><m:color "
              "color=\"#00FF00\"/></m:colorgroup><m:multiproperties id=\"3\" pids=\"1 2\"><m:multi "
              "pindices=\"0 1\"/></m:multiproperties><object id=\"4\" name=\"n\" pid=\"1\" "
              "pindex=\"0\">" +
              facet + "</resources><build><item objectid=\"4\" partnumber=\"p\"/></build></model>",
          ModelTag() + "<resources>" + strata::test::Tetrahedron(1) +
              "<object id=\"2\"><components><component objectid=\"1\" transform=\"0 1 0 -1 0 0 0 0 "
              "1 9 9 9\"/></components></object></resources><build><item objectid=\"2\"/><item "
              "objectid=\"1\" transform=\"-1 0 0 0 1 0 0 0 1 0 0 0\"/></build></model>"};
}

std::vector<std::string> MtlSeeds() {
  return {
      "# a\nnewmtl a\nKd 1 0.5 0\nmap_Kd -s 1 1 1 -o 0.5 -mm 0 1 -clamp on t.png\n"
      "newmtl b\nmap_Kd a b.png\nd 0.5\nillum 2\n",
      "map_Kd x\r\nnewmtl\r\nnewmtl a\r\nmap_Kd -bm 1\r\n"};
}

std::vector<std::string> AssimpSeeds() {
  using strata::io::AssimpRecord;
  std::string bytes;
  const auto put = [&](auto value) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  const auto text = [&](const std::string& value) {
    put(static_cast<std::uint32_t>(value.size()));
    bytes += value;
  };
  const auto list = [&](const std::string& name) {
    put(std::uint32_t{1});
    text(name);
  };
  put(AssimpRecord::kFailure);
  put(std::uint32_t{2});
  text("unknown");
  std::vector<std::string> seeds = {std::string(1, '\0') + bytes};
  for (const bool attributes : {false, true}) {
    bytes = attributes ? '\1' : '\0';
    put(AssimpRecord::kHead);
    for (const std::uint64_t count : {3, 1, 1, 0, 2}) put(count);
    text("FBX");
    list("oak");
    text("y");
    for (const std::uint32_t sets : {1, 1, 2}) put(sets);
    list("mesh");
    list("node");
    put(AssimpRecord::kPlaced);
    for (const std::uint32_t id : {0, 0, 0}) put(id);
    put(AssimpRecord::kPolygon);
    put(std::uint32_t{3});
    for (int i = 0; i < 9; ++i) put(i * 0.5);
    for (int i = 0; attributes && i < 3 * 11; ++i) put(static_cast<float>(i));
    put(AssimpRecord::kEnd);
    seeds.push_back(bytes);
  }
  return seeds;
}
