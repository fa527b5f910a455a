// What assimp reads, and what happens when it does not.
#include "io/assimp_reader.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "core/summarize_mesh.h"
#include "io/open_mesh.h"
#include "tests/support/attribute_values.h"
#include "tests/support/read_mesh.h"
#include "tests/support/temp_folder.h"
#include "tests/support/test_data.h"

namespace strata::io {
namespace {

OpenOptions WithProgram(const std::string& program = STRATA_ASSIMP_PROGRAM) {
  OpenOptions options;
  options.assimp = program;
  return options;
}

Result<test::WholeMesh> Read(const std::string& bytes, const std::string& name,
                             const OpenOptions& options = WithProgram()) {
  return test::ReadWhole(OpenMesh(MemorySource(bytes, name), options), 7);
}

double AreaOf(const test::WholeMesh& mesh) {
  double area = 0;
  for (const auto& [a, b, c] : mesh.triangles) area += 0.5 * Norm(Cross(b - a, c - a));
  return area;
}

// One file of each format, all with one surface: the square from (0,0,0) to (2,1,0).
struct Sample {
  const char* name;
  std::string bytes;
};

void Append16(std::string& bytes, unsigned value) {
  bytes += static_cast<char>(value & 255);
  bytes += static_cast<char>(value >> 8 & 255);
}
void Append32(std::string& bytes, std::uint32_t value) {
  Append16(bytes, value & 0xffff);
  Append16(bytes, value >> 16);
}
// A chunk of a 3DS file.
std::string Chunk(unsigned id, const std::string& content) {
  std::string chunk;
  Append16(chunk, id);
  Append32(chunk, static_cast<std::uint32_t>(content.size() + 6));
  return chunk + content;
}
std::string Make3ds() {
  std::string vertices, faces;
  Append16(vertices, 4);
  for (const float value : {0.f, 0.f, 0.f, 2.f, 0.f, 0.f, 2.f, 1.f, 0.f, 0.f, 1.f, 0.f}) {
    vertices.append(reinterpret_cast<const char*>(&value), sizeof(value));
  }
  Append16(faces, 2);
  for (const unsigned corner : {0, 1, 2, 7, 0, 2, 3, 7}) Append16(faces, corner);
  const std::string mesh = Chunk(0x4100, Chunk(0x4110, vertices) + Chunk(0x4120, faces));
  const std::string object = Chunk(0x4000, std::string("square\0", 7) + mesh);
  return Chunk(0x4d4d, Chunk(0x3d3d, object));
}

std::vector<Sample> Samples() {
  const std::string collada =
      "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
      "version=\"1.4.1\"><asset><up_axis>Y_UP</up_axis></asset><library_geometries>"
      "<geometry id=\"g\"><mesh><source id=\"p\"><float_array id=\"a\" count=\"12\">0 0 0 2 0 0 2 "
      "1 "
      "0 0 1 0</float_array><technique_common><accessor source=\"#a\" count=\"4\" stride=\"3\">"
      "<param name=\"X\" type=\"float\"/><param name=\"Y\" type=\"float\"/><param name=\"Z\" "
      "type=\"float\"/></accessor></technique_common></source><vertices id=\"v\"><input "
      "semantic=\"POSITION\" source=\"#p\"/></vertices><polylist count=\"1\"><input "
      "semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/><vcount>4</vcount><p>0 1 2 3</p></polylist>"
      "</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id=\"s\">"
      "<node><instance_geometry url=\"#g\"/></node></visual_scene></library_visual_scenes>"
      "<scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>";
  const std::string fbx =
      "; FBX 7.4.0 project file\nFBXHeaderExtension:  {\n\tFBXHeaderVersion: 1003\n\tFBXVersion: "
      "7400\n}\nObjects:  {\n\tGeometry: 10, \"Geometry::g\", \"Mesh\" {\n\t\tVertices: *12 "
      "{\n\t\t\t"
      "a: 0,0,0,2,0,0,2,1,0,0,1,0\n\t\t}\n\t\tPolygonVertexIndex: *4 {\n\t\t\ta: "
      "0,1,2,-4\n\t\t}\n\t}\n"
      "\tModel: 20, \"Model::m\", \"Mesh\" {\n\t\tVersion: 232\n\t}\n}\nConnections:  {\n\tC: "
      "\"OO\",20,0\n\tC: \"OO\",10,20\n}\n";
  const std::string ac3d =
      "AC3Db\nMATERIAL \"m\" rgb 1 1 1 amb 1 1 1 emis 0 0 0 spec 1 1 1 shi 0 trans 0\n"
      "OBJECT world\nkids 1\nOBJECT poly\nname \"s\"\nnumvert 4\n0 0 0\n2 0 0\n2 1 0\n0 1 0\n"
      "numsurf 1\nSURF 0x0\nmat 0\nrefs 4\n0 0 0\n1 0 0\n2 0 0\n3 0 0\nkids 0\n";
  const std::string directx =
      "xof 0303txt 0032\nFrame root {\n Mesh m {\n 4;\n 0;0;0;,\n 2;0;0;,\n 2;1;0;,\n 0;1;0;;\n "
      "1;\n 4;0,1,2,3;;\n }\n}\n";
  const std::string amf =
      "<?xml version=\"1.0\"?><amf unit=\"millimeter\"><object id=\"1\"><mesh><vertices>"
      "<vertex><coordinates><x>0</x><y>0</y><z>0</z></coordinates></vertex>"
      "<vertex><coordinates><x>2</x><y>0</y><z>0</z></coordinates></vertex>"
      "<vertex><coordinates><x>2</x><y>1</y><z>0</z></coordinates></vertex>"
      "<vertex><coordinates><x>0</x><y>1</y><z>0</z></coordinates></vertex></vertices><volume>"
      "<triangle><v1>0</v1><v2>1</v2><v3>2</v3></triangle>"
      "<triangle><v1>0</v1><v2>2</v2><v3>3</v3></triangle></volume></mesh></object></amf>";
  const std::string dxf =
      "0\nSECTION\n2\nENTITIES\n0\n3DFACE\n8\n0\n10\n0\n20\n0\n30\n0\n11\n2\n21\n0\n31\n0\n"
      "12\n2\n22\n1\n32\n0\n13\n0\n23\n1\n33\n0\n0\nENDSEC\n0\nEOF\n";
  return {{"square.dae", collada}, {"square.fbx", fbx},   {"square.3ds", Make3ds()},
          {"square.ac", ac3d},     {"square.x", directx}, {"square.amf", amf},
          {"square.dxf", dxf}};
}

TEST(Assimp, ReadsTheFormatsThatTheManualNames) {
  for (const Sample& sample : Samples()) {
    SCOPED_TRACE(sample.name);
    EXPECT_FALSE(OpenMesh(MemorySource(sample.bytes, sample.name))) << "not without being told";
    const auto mesh = Read(sample.bytes, sample.name);
    EXPECT_TRUE(mesh) << mesh.error().message;
    if (!mesh) continue;
    EXPECT_NEAR(AreaOf(*mesh), 2, 1e-6);
    EXPECT_TRUE(mesh->info.format.starts_with("assimp:")) << mesh->info.format;
    EXPECT_GE(mesh->info.contents.meshes.value_or(0), 1u);
  }
}

TEST(Assimp, StartsOverOnRewind) {
  const std::vector<Sample> samples = Samples();
  auto reader = OpenMesh(MemorySource(samples[0].bytes, samples[0].name), WithProgram());
  ASSERT_TRUE(reader) << reader.error().message;
  const auto first = test::ReadWhole(**reader, 1);
  ASSERT_TRUE((*reader)->Rewind());
  const auto second = test::ReadWhole(**reader, 64);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->triangles, second->triangles);
  EXPECT_EQ(first->counts.triangles, second->counts.triangles);
}

// COLLADA's `source` of `n` groups of numbers.
std::string Source(const std::string& id, const std::string& numbers, int n,
                   const std::string& names) {
  std::string params;
  for (const char name : names) {
    params += std::string("<param name=\"") + name + "\" type=\"float\"/>";
  }
  const auto stride = names.size(), count = names.size() * static_cast<std::size_t>(n);
  return "<source id=\"" + id + "\"><float_array id=\"" + id + "a\" count=\"" +
         std::to_string(count) + "\">" + numbers + "</float_array><technique_common><accessor " +
         "source=\"#" + id + "a\" count=\"" + std::to_string(n) + "\" stride=\"" +
         std::to_string(stride) + "\">" + params + "</accessor></technique_common></source>";
}

// A square with everything, placed as it is and mirrored in x at twice the size.
std::string FullCollada() {
  return "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" "
         "version=\"1.4.1\"><asset><up_axis>Y_UP</up_axis></asset><library_effects><effect "
         "id=\"e\">"
         "<profile_COMMON><technique sid=\"t\"><lambert/></technique></profile_COMMON></effect>"
         "</library_effects><library_materials><material id=\"m\" name=\"oak\"><instance_effect "
         "url=\"#e\"/></material></library_materials><library_geometries><geometry id=\"g\" "
         "name=\"square\"><mesh>" +
         Source("p", "0 0 0 1 0 0 1 1 0 0 1 0", 4, "XYZ") +
         Source("n", "0.6 0 0.8 0.6 0 0.8 0.6 0 0.8 0.6 0 0.8", 4, "XYZ") +
         Source("c", "0 0 0.5 1 0 0.5 1 1 0.5 0 1 0.5", 4, "RGB") +
         Source("u", "0 0 1 0 1 1 0 1", 4, "ST") + Source("w", "5 0 4 0 4 1 5 1", 4, "ST") +
         "<vertices id=\"v\"><input semantic=\"POSITION\" source=\"#p\"/></vertices><polylist "
         "count=\"1\" material=\"slot\"><input semantic=\"VERTEX\" source=\"#v\" offset=\"0\"/>"
         "<input semantic=\"NORMAL\" source=\"#n\" offset=\"0\"/><input semantic=\"COLOR\" "
         "source=\"#c\" offset=\"0\"/><input semantic=\"TEXCOORD\" source=\"#u\" offset=\"0\" "
         "set=\"0\"/><input semantic=\"TEXCOORD\" source=\"#w\" offset=\"0\" set=\"1\"/><vcount>4"
         "</vcount><p>0 1 2 3</p></polylist></mesh></geometry></library_geometries>"
         "<library_visual_scenes><visual_scene id=\"s\">" +
         [] {
           const std::string geometry =
               "<instance_geometry url=\"#g\"><bind_material><technique_common>"
               "<instance_material symbol=\"slot\" target=\"#m\"/></technique_common>"
               "</bind_material></instance_geometry></node>";
           return "<node id=\"here\">" + geometry + "<node id=\"there\"><scale>-2 2 2</scale>" +
                  geometry;
         }() +
         "</visual_scene></library_visual_scenes><scene><instance_visual_scene url=\"#s\"/></scene>"
         "</COLLADA>";
}

TEST(AssimpAttributes, ReachTheSamplesThroughThePipe) {
  const auto opened = OpenMesh(MemorySource(FullCollada(), "a.dae"), WithProgram());
  ASSERT_TRUE(opened) << opened.error().message;
  MeshReader& reader = **opened;
  EXPECT_EQ(Describe(reader.attributes()),
            "color (4 x float32, corner), uv (2 x float32, corner), uv_1 (2 x float32, corner), "
            "vertex_normal (3 x float32, corner), material (uint32, triangle), mesh (uint32, "
            "triangle), node (uint32, instance)");
  TriangleBatch batch(8);
  ASSERT_EQ(*reader.Read(batch), 4u);
  std::vector<SurfacePoint> points;
  std::vector<Vec3> at;
  for (std::uint64_t t = 0; t < 4; ++t) {
    points.push_back({t, {0.25, 0.25, 0.5}});
    at.push_back(batch.corner(t, 0) * 0.25 + batch.corner(t, 1) * 0.25 + batch.corner(t, 2) * 0.5);
  }
  const auto color = test::ValuesAt<float>(reader, "color", points),
             uv = test::ValuesAt<float>(reader, "uv", points),
             uv1 = test::ValuesAt<float>(reader, "uv_1", points),
             normal = test::ValuesAt<float>(reader, "vertex_normal", points);
  const auto node = test::ValuesAt<std::uint32_t>(reader, "node", points),
             material = test::ValuesAt<std::uint32_t>(reader, "material", points);
  const auto& node_names = reader.attributes()[test::NumberOf(reader, "node")].names;
  const auto& names = reader.attributes()[test::NumberOf(reader, "material")].names;
  // (0.6, 0, 0.8) under a scale of (-2, 2, 2): mirrored in x, as long as it was.
  for (std::size_t i = 0; i < 4; ++i) {
    const bool there = i >= 2;
    const Vec3 p = there ? Vec3{at[i].x / -2, at[i].y / 2, 0} : at[i];
    EXPECT_NEAR(color[4 * i], p.x, 1e-6);
    EXPECT_NEAR(color[4 * i + 1], p.y, 1e-6);
    EXPECT_EQ(color[4 * i + 2], 0.5f);
    EXPECT_EQ(color[4 * i + 3], 1);
    EXPECT_NEAR(uv[2 * i], p.x, 1e-6);
    EXPECT_NEAR(uv1[2 * i], 5 - p.x, 1e-6);
    EXPECT_NEAR(normal[3 * i], there ? -0.6 : 0.6, 1e-6);
    EXPECT_NEAR(normal[3 * i + 2], 0.8, 1e-6);
    ASSERT_LT(node[i], node_names.size());
    EXPECT_EQ(node_names[node[i]], there ? "there" : "here");
    ASSERT_LT(material[i], names.size());
    EXPECT_EQ(names[material[i]], "oak");
  }
  // The surface can be read again behind it.
  ASSERT_TRUE(reader.Rewind());
  EXPECT_EQ(*reader.Read(batch), 4u);
}

TEST(AssimpAttributes, OfEachFormatCanBeFetched) {
  for (const Sample& sample : Samples()) {
    SCOPED_TRACE(sample.name);
    const auto reader = OpenMesh(MemorySource(sample.bytes, sample.name), WithProgram());
    ASSERT_TRUE(reader) << reader.error().message;
    TriangleBatch batch(8);
    ASSERT_GE(*(*reader)->Read(batch), 1u);
    std::vector<SurfacePoint> points;
    for (std::size_t i = 0; i < batch.size(); ++i) points.push_back({batch.ids()[i], {0, 0, 1}});
    const auto& names = (*reader)->attributes()[test::NumberOf(**reader, "mesh")].names;
    for (const std::uint32_t id : test::ValuesAt<std::uint32_t>(**reader, "mesh", points)) {
      EXPECT_LT(id, names.size());
    }
  }
}

TEST(Assimp, RefusesWhatItDoesNotKnowEither) {
  const auto mesh = Read("once upon a time", "story.txt");
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kUnsupported) << mesh.error().message;
}

TEST(Assimp, EveryPrefixIsReadOrRefused) {
  for (const Sample& sample : Samples()) {
    const std::size_t step = sample.bytes.size() / 12 + 1;
    for (std::size_t n = 1; n < sample.bytes.size(); n += step) {
      const auto mesh = Read(sample.bytes.substr(0, n), sample.name);
      if (!mesh) {
        EXPECT_NE(mesh.error().message.find(sample.name), std::string::npos);
      }
    }
  }
}

// A program that behaves as the shell script says.
std::string Script(const test::TempFolder& folder, const std::string& body) {
  const std::string path = folder / "child.sh";
  test::WriteFile(path, "#!/bin/sh\n" + body + "\n");
  EXPECT_EQ(chmod(path.c_str(), 0700), 0);
  return path;
}

TEST(Assimp, ReportsHowTheOtherProcessDied) {
  test::TempFolder folder;
  const std::map<std::string, std::string> cases = {
      {"kill -SEGV $$", "killed by signal 11"},
      {"kill -XCPU $$", "more processor time"},
      {"exit 3", "ended too early, with status 3"},
      {"printf 'ASA'; exit 0", "ended too early"},
      {"printf 'nonsense and more of it'", "cannot be understood"}};
  for (const auto& [body, expected] : cases) {
    const auto mesh = Read("; FBX", "a.fbx", WithProgram(Script(folder, body)));
    ASSERT_FALSE(mesh) << body;
    EXPECT_EQ(mesh.error().code, ErrorCode::kCorruptInput);
    EXPECT_NE(mesh.error().message.find(expected), std::string::npos) << mesh.error().message;
  }
  const auto missing = Read("; FBX", "a.fbx", WithProgram("/nonexistent/strata-assimp"));
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound) << missing.error().message;
}

TEST(Assimp, EndsAtOnceWhenCancelled) {
  test::TempFolder folder;
  RunContext context;
  context.Cancel();
  OpenOptions options = WithProgram(Script(folder, "exec sleep 600"));
  options.context = &context;
  const auto mesh = Read("; FBX", "a.fbx", options);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kCancelled);
}

TEST(Assimp, MayNotUseMoreMemoryThanIsLeft) {
  std::string huge = "AC3Db\nOBJECT world\nkids 1\nOBJECT poly\nnumvert 400000\n";
  for (int i = 0; i < 400'000; ++i) huge += "0 0 0\n";
  huge += "numsurf 0\nkids 0\n";
  MemoryAccount little(std::uint64_t{1} << 20);
  OpenOptions options = WithProgram();
  options.memory = &little;
  const auto mesh = Read(huge + std::string(std::size_t{300} << 20, ' '), "a.ac", options);
  ASSERT_FALSE(mesh);
  EXPECT_EQ(mesh.error().code, ErrorCode::kOverBudget) << mesh.error().message;
  EXPECT_EQ(little.taken(), 0u);
}

Result<MeshSummary> Summarize(Result<std::unique_ptr<MeshReader>> reader) {
  if (!reader) return Forward(reader);
  RunContext context;
  return SummarizeMesh(**reader, context);
}

// Where the two read different things, and why ours is meant.
bool MeansSomethingElse(const std::string& path) {
  static const std::vector<std::string> kDifferent = {
      // assimp leaves out the last polygon.
      "cube_poly.off",
      "mpi.off",
      // It takes the line end behind the header for data.
      "cube_binary_starts_with_nl.ply",
      // It does not move a mesh by its skin.
      "simple_skin.gltf",
      // It divides positions by a fourth number.
      "cube-vertex-w-component.obj",
  };
  for (const std::string& end : kDifferent) {
    if (path.ends_with(end)) return true;
  }
  return false;
}

TEST(Assimp, AgreesOnAreasAndBoundsWhereBothReadAFile) {
  const std::filesystem::path folder = test::TestDataFolder(STRATA_SOURCE_DIR);
  if (!std::filesystem::exists(folder / "INDEX.tsv")) {
    GTEST_SKIP() << "no collection of meshes in " << folder << " (STRATA_TEST_DATA)";
  }
  int compared = 0;
  for (const test::IndexedFile& file : test::ReadIndex(folder)) {
    const std::string path = (folder / file.path).string();
    if (file.path.starts_with("scans/") || MeansSomethingElse(file.path)) continue;
    const auto ours = Summarize(OpenMesh(path));
    if (!ours || ours->area == 0) continue;
    auto source = OpenByteSource(path);
    ASSERT_TRUE(source);
    const auto theirs = Summarize(OpenAssimp(std::move(*source), WithProgram()));
    if (!theirs) continue;
    ++compared;
    EXPECT_NEAR(ours->area, theirs->area, 1e-5 * ours->area) << file.path;
    const double size = Norm(ours->bounds.max - ours->bounds.min);
    EXPECT_LE(Norm(ours->bounds.min - theirs->bounds.min), 1e-5 * size) << file.path;
    EXPECT_LE(Norm(ours->bounds.max - theirs->bounds.max), 1e-5 * size) << file.path;
  }
  EXPECT_GE(compared, 130);
}

}  // namespace
}  // namespace strata::io
