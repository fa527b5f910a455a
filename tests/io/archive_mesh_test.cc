#include "io/archive_mesh.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "io/open_mesh.h"
#include "io/zip_archive.h"
#include "tests/support/attribute_values.h"
#include "tests/support/compress.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/read_mesh.h"
#include "tests/support/temp_folder.h"
#include "tests/support/zip_maker.h"

namespace strata::io {
namespace {

using test::Make3mf;
using test::MakeZip;
using test::ModelTag;
using test::ReadWhole;
using test::Tetrahedron;
using Files = std::vector<std::pair<std::string, std::string>>;

const std::string kObj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

Result<test::WholeMesh> Read(const std::string& bytes, const std::string& member = "") {
  OpenOptions options;
  options.member = member;
  return ReadWhole(OpenMesh(MemorySource(bytes, "a.zip"), options));
}
void ExpectError(const std::string& bytes, ErrorCode code, const std::string& part) {
  const auto mesh = Read(bytes);
  ASSERT_FALSE(mesh) << "expected: " << part;
  EXPECT_EQ(mesh.error().code, code) << mesh.error().message;
  EXPECT_NE(mesh.error().message.find(part), std::string::npos) << mesh.error().message;
}

TEST(ZippedMesh, IsTheOnlyMeshAmongOtherFiles) {
  for (const Files& files : {Files{{"model.obj", kObj}},
                             Files{{"readme.txt", "x"}, {"in/model.obj", kObj}, {"in/t.png", "y"}},
                             Files{{"__MACOSX/._a.obj", "z"}, {"._b.obj", "z"}, {"c.obj", kObj}},
                             Files{{"model.obj.gz", test::Gzip(kObj)}}}) {
    const auto mesh = Read(MakeZip(files));
    ASSERT_TRUE(mesh) << mesh.error().message;
    EXPECT_EQ(mesh->triangles.size(), 1u);
    EXPECT_EQ(mesh->info.format, "obj");
  }
}

TEST(ZippedMesh, HasToBeNamedAmongSeveral) {
  const std::string bytes = MakeZip({{"a.obj", kObj}, {"b/c.obj", kObj + "f 3 2 1\n"}});
  ExpectError(bytes, ErrorCode::kUnsupported, "several meshes: 'a.obj', 'b/c.obj'");
  EXPECT_EQ(Read(bytes, "b/c.obj")->triangles.size(), 2u);
  EXPECT_EQ(Read(bytes, "d.obj").error().code, ErrorCode::kNotFound);
  test::TempFolder folder;
  test::WriteFile(folder / "x.zip", bytes);
  const auto named = ReadWhole(OpenMesh(folder / "x.zip#b/c.obj"));
  ASSERT_TRUE(named) << named.error().message;
  EXPECT_EQ(named->triangles.size(), 2u);
  EXPECT_EQ(folder.List(), std::vector<std::string>{"x.zip"}) << "nothing is unpacked beside it";
}

TEST(ZippedMesh, FindsItsCompanionsInTheArchiveAlone) {
  test::GltfMaker maker;
  maker.Primitive(maker.Floats3({0, 0, 0, 1, 0, 0, 0, 1, 0}));
  const Files files = {{"in/m.gltf", maker.TextBeside("d/b.bin")}, {"in/d/b.bin", maker.bin}};
  const auto mesh = Read(MakeZip(files));
  ASSERT_TRUE(mesh) << mesh.error().message;
  EXPECT_EQ(mesh->triangles.size(), 1u);
  ExpectError(MakeZip({{"in/m.gltf", maker.TextBeside("b.bin")}, {"b.bin", maker.bin}}),
              ErrorCode::kNotFound, "the archive has no 'in/b.bin'");
  ExpectError(MakeZip({{"in/m.gltf", maker.TextBeside("../b.bin")}, {"b.bin", maker.bin}}),
              ErrorCode::kUnsupported, "leads out of the folder");
}

TEST(ZippedMesh, IsRefusedWhereTheArchiveHasNone) {
  ExpectError(MakeZip({{"readme.txt", "x"}}), ErrorCode::kUnsupported, "holds 'readme.txt'");
  ExpectError(MakeZip({{"m.obj@", "/etc/passwd"}}), ErrorCode::kUnsupported, "holds nothing");
  ExpectError(MakeZip({{"m.obj", MakeZip({{"n.obj", kObj}})}}), ErrorCode::kUnsupported,
              "an archive in an archive");
}

TEST(ZippedMesh, IsBoundedBothInRatioAndInSize) {
  ExpectError(MakeZip({{"bomb.obj", std::string(std::size_t{65} << 20, '#')}}),
              ErrorCode::kOverBudget, "200 times its size");
}

TEST(ZippedMesh, RejectsEveryPrefixAndDamage) {
  const std::string bytes = MakeZip({{"a.obj", kObj}});
  for (std::size_t n = 4; n < bytes.size(); ++n) {
    const auto mesh = Read(bytes.substr(0, n));
    ASSERT_FALSE(mesh) << n;
    EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << n << ": " << mesh.error().message;
  }
  // A digit of the packed text: the checksum tells.
  int read = 0;
  // Behind the member's header of 30 bytes, its name and its extra field, whose lengths it says.
  const auto byte = [&](std::size_t at) { return static_cast<unsigned char>(bytes[at]); };
  const std::size_t begin = 30u + byte(26) + byte(28);
  for (std::size_t at = begin; at < begin + 12; ++at) {
    std::string damaged = bytes;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x10);
    read += Read(damaged) ? 1 : 0;
  }
  EXPECT_EQ(read, 0);
}

TEST(ThreeMf, PlacesObjectsAndComponentsOfItsBuild) {
  const std::string bytes =
      Make3mf(ModelTag("unit=\"inch\"") +
              "<resources><basematerials id=\"9\"><base name=\"red\" "
              "displaycolor=\"#FF0000\"/></basematerials>" +
              Tetrahedron(1) + Tetrahedron(7) +
              "<object id=\"2\"><components><component objectid=\"1\"/><component objectid=\"1\" "
              "transform=\"0 1 0 -1 0 0 0 0 1 10 20 30\"/></components></object></resources><build>"
              "<item objectid=\"2\" transform=\"2 0 0 0 2 0 0 0 2 100 0 0\"/><item objectid=\"1\"/>"
              "</build></model>");
  const auto mesh = Read(bytes);
  ASSERT_TRUE(mesh) << mesh.error().message;
  ASSERT_EQ(mesh->triangles.size(), 12u);
  EXPECT_EQ(mesh->triangles[0][1], (Vec3{100, 2, 0}));
  // (0, 1, 0) turned is (-1, 0, 0), moved (9, 20, 30), and so on.
  EXPECT_EQ(mesh->triangles[4][1], (Vec3{118, 40, 60}));
  EXPECT_EQ(mesh->triangles[9][2], (Vec3{0, 0, 0.1f})) << "the same number as of other formats";
  const MeshContents& contents = mesh->info.contents;
  EXPECT_EQ(contents.unit, "inch");
  EXPECT_EQ(contents.materials, std::vector<std::string>{"red"});
  EXPECT_EQ(contents.meshes, 2u);
  EXPECT_EQ(contents.passed_over[0].first, "meshes outside the build");
  EXPECT_EQ(mesh->counts.vertices, 8u);
}

// One triangle per object, with these attributes of object and triangle.
std::string Facet(int id, const std::string& object, const std::string& triangle) {
  return "<object id=\"" + std::to_string(id) + "\" " + object +
         "><mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/>"
         "<vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles>"
         "<triangle v1=\"0\" v2=\"1\" v3=\"2\" " +
         triangle + "/><triangle v1=\"0\" v2=\"2\" v3=\"1\"/></triangles></mesh></object>";
}

std::string Coloured() {
  return Make3mf(
      ModelTag("xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\"") +
      "<resources><basematerials id=\"1\"><base name=\"oak\" displaycolor=\"#804000\"/>"
      "<base name=\"ash\" displaycolor=\"#10203040\"/></basematerials>"
      "<m:colorgroup id=\"2\"><m:color color=\"#FF0000\"/><m:color color=\"#00FF00\"/>"
      "<m:color color=\"#0000FF00\"/></m:colorgroup>"
      "<m:multiproperties id=\"3\" pids=\"1 2\"><m:multi pindices=\"1 2\"/></m:multiproperties>" +
      Facet(11, "name=\"left\" pid=\"1\" pindex=\"1\"", "pid=\"2\" p1=\"0\" p2=\"1\" p3=\"2\"") +
      Facet(12, "", "pid=\"3\" p1=\"0\"") + Facet(13, "pid=\"1\"", "p1=\"0\"") +
      "</resources><build><item objectid=\"11\" partnumber=\"A-1\"/><item objectid=\"12\"/>"
      "<item objectid=\"13\" partnumber=\"B\"/>"
      "<item objectid=\"11\" transform=\"-1 0 0 0 1 0 0 0 1 0 0 0\"/></build></model>");
}

TEST(ThreeMfAttributes, AreColoursMaterialsObjectsAndItems) {
  const auto opened = OpenMesh(MemorySource(Coloured(), "a.3mf"));
  ASSERT_TRUE(opened) << opened.error().message;
  MeshReader& reader = **opened;
  EXPECT_EQ(Describe(reader.attributes()),
            "color (4 x uint8, corner), material (uint32, triangle), object (uint32, triangle), "
            "item (uint32, instance)");
  using Names = std::vector<std::string>;
  EXPECT_EQ(reader.attributes()[1].names, (Names{"oak", "ash"}));
  EXPECT_EQ(reader.attributes()[2].names, (Names{"left", "object 12", "object 13"}));
  EXPECT_EQ(reader.attributes()[3].names, (Names{"A-1", "", "B", ""}));
  // Triangles 0 to 3 are the first object's, placed twice; then two for each of the others.
  std::vector<SurfacePoint> points;
  for (std::uint64_t t = 0; t < 8; ++t) points.push_back({t, {0, 0, 1}});
  const auto color = test::ValuesAt<std::uint8_t>(reader, "color", points);
  const std::vector<std::uint8_t> expected = {
      0,    0,    255,  0,
      0x10, 0x20, 0x30, 0x40,  // A group's third; the object's own material.
      0,    255,  0,    255,   // Mirrored: the second corner is third now.
      0x10, 0x20, 0x30, 0x40,  //
      0,    0,    255,  0,
      255,  255,  255,  255,  // The layer of colours; nothing at all.
      0x80, 0x40, 0,    255,
      255,  255,  255,  255};
  EXPECT_EQ(color, expected);
  const std::uint32_t none = UINT32_MAX;
  EXPECT_EQ(test::ValuesAt<std::uint32_t>(reader, "material", points),
            (std::vector<std::uint32_t>{none, 1, none, 1, 1, none, 0, none}));
  EXPECT_EQ(test::ValuesAt<std::uint32_t>(reader, "object", points),
            (std::vector<std::uint32_t>{0, 0, 0, 0, 1, 1, 2, 2}));
  EXPECT_EQ(test::ValuesAt<std::uint32_t>(reader, "item", points),
            (std::vector<std::uint32_t>{0, 0, 3, 3, 1, 1, 2, 2}));
  EXPECT_EQ(test::ValuesAt<std::uint8_t>(reader, "color", {{0, {0.5, 0.25, 0.25}}}),
            (std::vector<std::uint8_t>{128, 64, 64, 191}));
}

TEST(ThreeMfAttributes, OfAPlainPackageAreObjectsAndItems) {
  const auto reader =
      OpenMesh(MemorySource(Make3mf(ModelTag() + "<resources>" + Tetrahedron(1) +
                                    "</resources><build><item objectid=\"1\"/></build></model>"),
                            "a.3mf"));
  ASSERT_TRUE(reader) << reader.error().message;
  EXPECT_EQ(Describe((*reader)->attributes()),
            "object (uint32, triangle), item (uint32, instance)");
}

TEST(ThreeMfAttributes, ThatMakeNoSenseAreRefusedWithTheirLine) {
  const auto with = [](const std::string& resources) {
    return Make3mf(
        ModelTag("xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\"") +
        "<resources>\n" + resources + Tetrahedron(1) +
        "</resources><build><item objectid=\"1\"/></build></model>");
  };
  ExpectError(with("<m:colorgroup id=\"2\"><m:color color=\"red\"/></m:colorgroup>"),
              ErrorCode::kCorruptInput, "line 3: color: found 'red', expected a colour");
  ExpectError(with("<basematerials id=\"2\"/><m:colorgroup id=\"2\"/>"), ErrorCode::kCorruptInput,
              "a second group of properties 2");
  ExpectError(with("<m:multiproperties id=\"2\" pids=\"1 x\"/>"), ErrorCode::kCorruptInput,
              "expected whole numbers");
  const auto unknown = Read(with("<m:texture2dgroup id=\"4\" texid=\"5\"/>"));
  ASSERT_TRUE(unknown) << unknown.error().message;
  EXPECT_EQ(unknown->info.contents.passed_over[0].first, "groups of textures or composites");
}

TEST(ThreeMf, FollowsComponentsIntoOtherParts) {
  const auto with = [](const std::string& path) {
    return Make3mf(ModelTag("requiredextensions=\"p\"") +
                       "<resources><object id=\"2\"><components><component p:path=\"" + path +
                       "\" objectid=\"1\"/></components></object></resources>"
                       "<build><item objectid=\"2\"/></build></model>",
                   {{"3D/Objects/o.model", ModelTag() + "<resources>" + Tetrahedron(1) +
                                               "</resources><build/></model>"}});
  };
  const auto mesh = Read(with("/3D/Objects/o.model"));
  ASSERT_TRUE(mesh) << mesh.error().message;
  EXPECT_EQ(mesh->triangles.size(), 4u);
  ExpectError(with("/../../etc/passwd"), ErrorCode::kNotFound, "not in the archive");
}

TEST(ThreeMf, SaysWhatIsWrongAndWhere) {
  const auto model = [](const std::string& resources, const std::string& build,
                        const std::string& tag = ModelTag()) {
    return Make3mf(tag + "\n<resources>" + resources + "</resources>\n<build>" + build +
                   "</build></model>");
  };
  const std::string item = "<item objectid=\"1\"/>";
  ExpectError(model(Tetrahedron(1), "<item objectid=\"5\"/>"), ErrorCode::kCorruptInput,
              "object 5 of '3D/3dmodel.model' is not there");
  ExpectError(
      model("<object id=\"1\"><components><component objectid=\"1\"/></components></object>", item),
      ErrorCode::kCorruptInput, "nested too deeply");
  ExpectError(model("<object id=\"1\"><mesh><vertices><vertex x=\"a\" y=\"0\" z=\"0\"/>", item),
              ErrorCode::kCorruptInput, "line 3: x: found 'a', expected a number");
  ExpectError(model(Tetrahedron(1) + Tetrahedron(1), item), ErrorCode::kCorruptInput,
              "a second object 1");
  ExpectError(
      model(Tetrahedron(1), item, ModelTag("requiredextensions=\"q\" xmlns:q=\"urn:voxels\"")),
      ErrorCode::kUnsupported, "'urn:voxels' is required");
  ExpectError(Make3mf("<!DOCTYPE m [<!ENTITY a \"b\">]>" + ModelTag() + "&a;</model>"),
              ErrorCode::kCorruptInput, "found a document type");
  // 2^40 placings by forty objects, each twice in the next.
  std::string doubling = Tetrahedron(1);
  for (int id = 2; id <= 40; ++id) {
    const std::string part = "<component objectid=\"" + std::to_string(id - 1) + "\"/>";
    doubling += "<object id=\"" + std::to_string(id) + "\"><components>" + part + part +
                "</components></object>";
  }
  ExpectError(model(doubling, "<item objectid=\"40\"/>"), ErrorCode::kOverBudget, "placings");
}

TEST(ThreeMf, CountsCornersThatNameNoVertex) {
  std::string object = Tetrahedron(1);
  object.replace(object.find("v2=\"2\""), 6, "v2=\"99\"");
  const auto mesh = Read(Make3mf(ModelTag() + "<resources>" + object +
                                 "</resources><build><item objectid=\"1\"/></build></model>"));
  ASSERT_TRUE(mesh) << mesh.error().message;
  EXPECT_EQ(mesh->skipped(SkipReason::kIndexOutOfRange), 1u);
  EXPECT_EQ(mesh->triangles.size(), 3u);
}

TEST(ThreeMf, RejectsEveryPrefix) {
  const std::string bytes = Make3mf(ModelTag() + "<resources>" + Tetrahedron(1) +
                                    "</resources><build><item objectid=\"1\"/></build></model>");
  ASSERT_TRUE(Read(bytes));
  for (std::size_t n = 4; n < bytes.size(); ++n) {
    const auto mesh = Read(bytes.substr(0, n));
    ASSERT_FALSE(mesh) << n;
    EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput) << n << ": " << mesh.error().message;
  }
}

}  // namespace
}  // namespace strata::io
