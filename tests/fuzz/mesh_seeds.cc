#include "tests/fuzz/mesh_seeds.h"

#include <cstdint>

#include "tests/support/draco_maker.h"
#include "tests/support/gltf_maker.h"
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

}  // namespace

std::vector<std::string> GltfSeeds() {
  std::vector<std::string> seeds;
  for (const GltfMaker& maker : {Various(), Skinned(), Packed()}) {
    seeds.push_back(maker.Text());
    seeds.push_back(maker.Glb());
  }
  return seeds;
}

std::vector<std::string> DracoSeeds() {
  return {strata::test::MakeDraco(3, true), strata::test::MakeDraco(3, false, true)};
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
