#include "io/open_mesh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <map>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "io/byte_source.h"
#include "tests/support/compress.h"
#include "tests/support/mesh_text.h"
#include "tests/support/read_mesh.h"
#include "tests/support/test_data.h"

namespace strata::io {
namespace {

using test::ReadWhole;

Result<test::WholeMesh> Read(const std::string& bytes, const std::string& name = "memory") {
  return ReadWhole(OpenMesh(MemorySource(bytes, name)));
}

TEST(OpenMesh, TellsFormatsByContentPackedOrNot) {
  const std::string ply = test::MakePly(
      "binary_big_endian",
      {test::PlyVertices({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}), test::PlyFaces({{0, 1, 2}})});
  const std::string ascii = test::MakeAsciiStl({{0, 0, 0, 1, 0, 0, 0, 1, 0}});
  const std::string binary = test::MakeBinaryStl({{0, 0, 0, 1, 0, 0, 0, 1, 0}}, "solid");
  for (const auto& [bytes, format] :
       {std::pair(ply, "ply"), std::pair(ascii, "stl"), std::pair(binary, "stl")}) {
    for (const auto& [stored, compression] :
         {std::pair(bytes, "none"), std::pair(test::Gzip(bytes), "gzip"),
          std::pair(test::Zstd(bytes), "zstd")}) {
      auto mesh = Read(stored, "misleading.obj");
      ASSERT_TRUE(mesh) << mesh.error().message;
      EXPECT_EQ(mesh->triangles.size(), 1u);
      EXPECT_EQ(mesh->info.format, format);
      EXPECT_EQ(mesh->info.compression, compression);
    }
  }
}

TEST(OpenMesh, ReportsProgressInStoredBytes) {
  const std::string bytes = test::Gzip(test::MakeBinaryStl({{0, 0, 0, 1, 0, 0, 0, 1, 0}}));
  auto reader = OpenMesh(MemorySource(bytes));
  ASSERT_TRUE(reader) << reader.error().message;
  ASSERT_TRUE(ReadWhole(**reader));
  EXPECT_EQ((*reader)->bytes_read(), bytes.size());
  EXPECT_EQ((*reader)->bytes_total(), bytes.size());
}

TEST(OpenMesh, PassesOnWhatIsWrongWithThePathOrTheFile) {
  auto missing = OpenMesh("/nonexistent/model.ply");
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().code, ErrorCode::kNotFound);
  auto empty = Read("");
  ASSERT_FALSE(empty);
  EXPECT_EQ(empty.error().code, ErrorCode::kCorruptInput);
  auto packed_empty = Read(test::Zstd(""));
  ASSERT_FALSE(packed_empty);
  EXPECT_EQ(packed_empty.error().code, ErrorCode::kCorruptInput);
  auto picture = Read("\x89PNG...");
  ASSERT_FALSE(picture);
  EXPECT_EQ(picture.error().code, ErrorCode::kUnsupported);
}

// Files that are refused, and why.
const std::map<std::string, std::string>& ExpectedErrors() {
  static const std::map<std::string, std::string> kErrors = {
      // The vertices' list property is missing from the rows.
      {"nasty/assimp/test/models/PLY/issue623.ply", "line 14: found the end of the line"},
      // Thirteen vertices where the header says twelve.
      {"nasty/tri/models/points_emptyascii.ply", "expected the end of the file"},
      {"nasty/assimp/test/models/OFF/invalid.off", "line 7: found the end of the line"},
      {"nasty/assimp/test/models/invalid/OutOfMemory.off", "expected 353535235358 vertices"},
      {"nasty/assimp/test/models/invalid/empty.obj", "the file is empty"},
      {"nasty/osc/stl/empty.stl", "the file is empty"},
      {"nasty/osc/stl/invalidvertex.stl", "line 89: found 'blah', expected a number"},
      // A control character among the digits.
      {"nasty/osc/stl/unparseable.stl", "expected a number"},
  };
  return kErrors;
}

std::array<double, 6> ParseBounds(std::string text) {
  for (char& c : text) c = c == ',' || c == ':' ? ' ' : c;
  std::istringstream in(text);
  std::array<double, 6> bounds{};
  for (double& b : bounds) in >> b;
  return bounds;
}

void ExpectAsIndexed(const test::IndexedFile& file, const test::WholeMesh& mesh) {
  EXPECT_EQ(mesh.counts.vertices, std::stoull(file.vertices));
  EXPECT_EQ(mesh.counts.faces, std::stoull(file.faces));
  // The index gives faces with too few corners no triangles.
  EXPECT_EQ(mesh.counts.triangles - mesh.skipped(SkipReason::kTooFewCorners),
            std::stoull(file.triangles));
  Bounds bounds;
  const auto add = [&](Vec3 v) {
    if (std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z)) bounds.Add(v);
  };
  for (const Vec3 v : mesh.vertices) add(v);
  for (const auto& triangle : mesh.triangles) {
    for (const Vec3 v : triangle) add(v);
  }
  if (bounds.empty()) return;
  const auto expected = ParseBounds(file.bounds);
  for (int a = 0; a < 3; ++a) {
    const auto i = static_cast<std::size_t>(a);
    // The index has six digits.
    EXPECT_NEAR(bounds.min[a], expected[i], 1e-5 * std::fabs(expected[i]) + 1e-12);
    EXPECT_NEAR(bounds.max[a], expected[3 + i], 1e-5 * std::fabs(expected[3 + i]) + 1e-12);
  }
}

bool IsOneOf(const test::IndexedFile& file, std::initializer_list<const char*> formats) {
  return std::any_of(formats.begin(), formats.end(),
                     [&](const char* f) { return file.format.starts_with(f); });
}

class IndexedFiles : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(folder_ / "INDEX.tsv")) {
      GTEST_SKIP() << "no collection of meshes in " << folder_ << " (STRATA_TEST_DATA)";
    }
    files_ = test::ReadIndex(folder_);
  }
  std::filesystem::path folder_ = test::TestDataFolder(STRATA_SOURCE_DIR);
  std::vector<test::IndexedFile> files_;
};

TEST_F(IndexedFiles, OfEveryFormatReadHaveTheCountsAndBoundsOfTheIndex) {
  int read = 0;
  for (const test::IndexedFile& file : files_) {
    if (!IsOneOf(file, {"PLY", "STL", "OBJ", "OFF", "COFF"})) continue;
    SCOPED_TRACE(file.path + " " + file.notes);
    auto mesh = ReadWhole(OpenMesh((folder_ / file.path).string()), 4096);
    const auto expected = ExpectedErrors().find(file.path);
    if (expected != ExpectedErrors().end()) {
      ASSERT_FALSE(mesh);
      EXPECT_NE(mesh.error().message.find(expected->second), std::string::npos)
          << mesh.error().message;
      continue;
    }
    EXPECT_TRUE(mesh) << mesh.error().message;
    if (!mesh) continue;
    ++read;
    if (file.path.ends_with("delim_test.ply")) {
      // Lines that end in CR alone, which the index did not read.
      EXPECT_EQ(mesh->counts.vertices, 24u);
      EXPECT_EQ(mesh->counts.triangles, 12u);
      continue;
    }
    ExpectAsIndexed(file, *mesh);
  }
  EXPECT_GE(read, 160);
}

}  // namespace
}  // namespace strata::io
