// What a PLY carries reaches its samples: each value against one computed from the position.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/sample_mesh.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/mesh_text.h"
#include "tests/support/samples_equal.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::kPlyFormats;
using test::MakePly;
using test::PlyPart;
using test::TempFolder;

using Options = SampleOptions;

Options WithAttributes(std::vector<std::string> names) {
  Options options;
  options.lattice = Resolution{40};
  options.attributes = kNormal | kTriangle | kBarycentric;
  options.mesh_attributes = std::move(names);
  options.threads = 2;
  return options;
}

Result<SampleResult> Sample(const std::string& file, const Options& options) {
  RunContext context;
  auto reader = OpenMesh(MemorySource(file, "mesh.ply"));
  if (!reader) return Forward(reader);
  return SampleMesh(**reader, options, context);
}

// The values of a carried column, component by component.
template <class T>
std::vector<T> Column(const SampleResult& result, const std::string& name) {
  for (std::size_t k = 0; k < result.carried.size(); ++k) {
    if (result.carried[k].name != name) continue;
    const std::vector<char>& bytes = result.samples.carried[k];
    std::vector<T> values(bytes.size() / sizeof(T));
    std::memcpy(values.data(), bytes.data(), bytes.size());
    EXPECT_EQ(bytes.size(), result.samples.size() * result.carried[k].bytes());
    return values;
  }
  ADD_FAILURE() << "no column " << name;
  return {};
}

constexpr int kSide = 12;

double Height(double x, double y) { return 0.25 * std::floor(8 * x * (1 - y)) / 8; }

// A sheet of quads (or triangles) with values that are linear in x and y, and labels.
std::vector<PlyPart> Sheet(bool quads) {
  PlyPart vertices{"vertex",
                   {"float quality", "float x", "double y", "float z", "uchar red", "uchar green",
                    "uchar blue", "uchar alpha", "int label", "float nx", "float ny", "float nz",
                    "double s", "double t", "ushort code"},
                   {}};
  PlyPart faces{"face", {"uchar tag", "list uchar int vertex_indices", "float heat"}, {}};
  for (int j = 0; j <= kSide; ++j) {
    for (int i = 0; i <= kSide; ++i) {
      const double x = static_cast<double>(i) / 16, y = static_cast<double>(j) / 16;
      vertices.rows.push_back({3 * x - y, x, y, Height(x, y), 255 * x, 255 * y, 17, 200,
                               -10000007.0 + 16 * j + i, x, y, 1, x, y, i * 100.0 + j});
    }
  }
  for (int j = 0; j < kSide; ++j) {
    for (int i = 0; i < kSide; ++i) {
      const double a = j * (kSide + 1) + i, b = a + 1, d = a + kSide + 1, c = d + 1;
      const double tag = j * kSide + i, heat = tag / 8;
      if (quads) {
        faces.rows.push_back({tag, 4, a, b, c, d, heat});
      } else {
        faces.rows.push_back({tag, 3, a, b, c, heat});
        faces.rows.push_back({tag, 3, a, c, d, heat});
      }
    }
  }
  // Rows as the file has them: bytes and whole numbers.
  for (auto& row : vertices.rows) {
    for (const std::size_t k : {4, 5}) row[k] = std::round(row[k]);
  }
  return {vertices, faces};
}

// Every value against the position; the colour's corners are rounded.
void ExpectSheet(const SampleResult& result) {
  const SampleColumns& s = result.samples;
  ASSERT_GT(s.size(), 500u);
  const auto quality = Column<float>(result, "quality");
  const auto color = Column<std::uint8_t>(result, "color");
  const auto label = Column<std::int32_t>(result, "label");
  const auto code = Column<std::uint16_t>(result, "code");
  const auto uv = Column<double>(result, "uv");
  const auto tag = Column<std::uint8_t>(result, "tag");
  const auto heat = Column<float>(result, "heat");
  for (std::size_t i = 0; i < s.size(); ++i) {
    const Vec3 p = s.position[i];
    EXPECT_NEAR(quality[i], 3 * p.x - p.y, 1e-6);
    EXPECT_NEAR(uv[2 * i], p.x, 1e-12);
    EXPECT_NEAR(uv[2 * i + 1], p.y, 1e-12);
    EXPECT_NEAR(color[4 * i], 255 * p.x, 1.001);
    EXPECT_NEAR(color[4 * i + 1], 255 * p.y, 1.001);
    EXPECT_EQ(color[4 * i + 2], 17);
    EXPECT_EQ(color[4 * i + 3], 200);
    const int x = static_cast<int>(std::floor(p.x * 16)), y = static_cast<int>(p.y * 16);
    EXPECT_EQ(tag[i], y * kSide + x);
    EXPECT_EQ(heat[i], static_cast<float>(tag[i]) / 8);
    // One of the quad's corners, and the same one for both labels.
    const int n = label[i] + 10000007, at_x = n % 16, at_y = n / 16;
    EXPECT_TRUE((at_x == x || at_x == x + 1) && (at_y == y || at_y == y + 1)) << label[i];
    EXPECT_EQ(code[i], at_x * 100 + at_y);
  }
}

TEST(PlyAttributes, ReachTheSamplesInEveryEncoding) {
  for (const char* const format : kPlyFormats) {
    for (const bool quads : {true, false}) {
      SCOPED_TRACE(std::string(format) + (quads ? ", quads" : ", triangles"));
      const auto result = Sample(MakePly(format, Sheet(quads)), WithAttributes({"all"}));
      ASSERT_TRUE(result) << result.error().message;
      ExpectSheet(*result);
    }
  }
}

TEST(PlyAttributes, OfFacesAloneNeedNoVertices) {
  for (const char* const format : kPlyFormats) {
    const auto result = Sample(MakePly(format, Sheet(true)), WithAttributes({"tag"}));
    ASSERT_TRUE(result) << result.error().message;
    const auto tag = Column<std::uint8_t>(*result, "tag");
    for (std::size_t i = 0; i < tag.size(); ++i) {
      EXPECT_EQ(tag[i], result->samples.triangle[i] / 2);
    }
  }
}

TEST(PlyAttributes, SayWhatTheyAre) {
  auto reader = OpenMesh(MemorySource(MakePly("ascii", Sheet(true)), "mesh.ply"));
  ASSERT_TRUE(reader) << reader.error().message;
  EXPECT_EQ(Describe((*reader)->attributes()),
            "color (4 x uint8, vertex), vertex_normal (3 x float32, vertex), uv (2 x float64, "
            "vertex), quality (float32, vertex), label (int32, vertex), code (uint16, vertex), "
            "tag (uint8, triangle), heat (float32, triangle)");
  const MeshAttribute& color = (*reader)->attributes()[0];
  EXPECT_EQ(color.semantic, Semantic::kColor);
  EXPECT_EQ(color.color_space, ColorSpace::kSrgb);
  EXPECT_TRUE(color.normalized);
}

TEST(PlyAttributes, AreTheSameInEveryEncodingCompressionAndOrderOfTheColumns) {
  const auto parts = Sheet(false);
  const auto expected = Sample(MakePly("ascii", parts), WithAttributes({"all"}));
  ASSERT_TRUE(expected) << expected.error().message;
  for (const char* const format : kPlyFormats) {
    for (const bool packed : {false, true}) {
      const std::string plain = MakePly(format, parts);
      const auto result =
          Sample(packed ? test::Gzip(plain) : plain, WithAttributes({"heat", "all"}));
      ASSERT_TRUE(result) << result.error().message;
      EXPECT_TRUE(test::SameSamples(expected->samples, result->samples));
      EXPECT_EQ(expected->samples.carried, result->samples.carried) << format;
    }
  }
}

TEST(PlyAttributes, DoNotDependOnTheOrderOfTrianglesOrTheirFirstCorner) {
  auto parts = Sheet(false);
  const auto expected = Sample(MakePly("binary_little_endian", parts), WithAttributes({"all"}));
  test::TestRandom random(5);
  random.Shuffle(parts[1].rows);
  for (auto& row : parts[1].rows) {
    std::rotate(row.begin() + 2, row.begin() + 2 + static_cast<int>(random.Below(3)),
                row.begin() + 5);
  }
  const auto result = Sample(MakePly("binary_little_endian", parts), WithAttributes({"all"}));
  ASSERT_TRUE(expected && result);
  EXPECT_TRUE(test::SameSamples(expected->samples, result->samples));
  EXPECT_EQ(expected->samples.carried, result->samples.carried);
}

TEST(PlyAttributes, GiveTheSameOutOfMemory) {
  const std::string file = MakePly("binary_little_endian", Sheet(true));
  const std::string text = MakePly("ascii", Sheet(true));
  Options options = WithAttributes({"all"});
  options.attributes = kAllAttributes;
  options.lattice = Resolution{300};
  options.batch_size = 64;
  options.min_distance = 0.3;
  const auto expected = Sample(file, options);
  ASSERT_TRUE(expected) << expected.error().message;
  TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  for (const std::string* const bytes : {&file, &text}) {
    options.threads = bytes == &file ? 1 : 2;
    RunContext context(std::uint64_t{26} << 20);  // Half of it does not hold the samples.
    context.SetScratch(scratch->get());
    auto reader = OpenMesh(MemorySource(*bytes, "mesh.ply"));
    ASSERT_TRUE(reader);
    const auto result = SampleMesh(**reader, options, context);
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_TRUE(test::SameSamples(expected->samples, result->samples));
    EXPECT_EQ(expected->samples.triangle, result->samples.triangle);
    EXPECT_TRUE(expected->samples.carried == result->samples.carried);
  }
}

TEST(PlyAttributes, VertexNormalsAreInterpolatedAndOfLengthOne) {
  Options options = WithAttributes({});
  options.vertex_normals = true;
  options.attributes = kNormal;
  const auto result = Sample(MakePly("ascii", Sheet(true)), options);
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_TRUE(result->carried.empty());
  EXPECT_TRUE(result->samples.triangle.empty() && result->samples.barycentric.empty());
  for (std::size_t i = 0; i < result->samples.size(); ++i) {
    const Vec3 p = result->samples.position[i];
    const double length = Norm(Vec3{p.x, p.y, 1});
    const Vec3f n = result->samples.normal[i];
    EXPECT_NEAR(n.x, p.x / length, 1e-6);
    EXPECT_NEAR(n.y, p.y / length, 1e-6);
    EXPECT_NEAR(n.z, 1 / length, 1e-6);
  }
}

// Two triangles that share an edge, with UVs that do not match there.
TEST(PlyAttributes, KeepSeamsOfCornersApart) {
  const std::vector<PlyPart> parts = {
      {"vertex", {"float x", "float y", "float z"}, {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}},
      {"face",
       {"list uchar int vertex_indices", "list uchar float texcoord"},
       {{3, 0, 1, 2, 6, 0, 0, 1, 0, 1, 1}, {3, 0, 2, 3, 6, 5, 5, 6, 6, 5, 6}}}};
  for (const char* const format : kPlyFormats) {
    const auto result = Sample(MakePly(format, parts), WithAttributes({"uv"}));
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_EQ(result->carried[0].domain, AttributeDomain::kCorner);
    const auto uv = Column<float>(*result, "uv");
    for (std::size_t i = 0; i < result->samples.size(); ++i) {
      const double apart = result->samples.triangle[i] == 0 ? 0 : 5;
      EXPECT_NEAR(uv[2 * i], result->samples.position[i].x + apart, 1e-6);
      EXPECT_NEAR(uv[2 * i + 1], result->samples.position[i].y + apart, 1e-6);
    }
  }
}

TEST(PlyAttributes, ListsOfOneLengthAreVectorsAndOthersAnError) {
  std::vector<PlyPart> parts = {{"vertex",
                                 {"list uchar int ids", "float x", "float y", "float z"},
                                 {{2, 7, 8, 0, 0, 0}, {2, 7, 8, 1, 0, 0}, {2, 7, 8, 0, 1, 0}}},
                                {"face", {"list uchar int vertex_indices"}, {{3, 0, 1, 2}}}};
  for (const char* const format : kPlyFormats) {
    const auto result = Sample(MakePly(format, parts), WithAttributes({"ids"}));
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_EQ(Describe(result->carried), "ids (2 x int32, vertex)");
    const auto ids = Column<std::int32_t>(*result, "ids");
    for (std::size_t i = 0; i < ids.size(); ++i) EXPECT_EQ(ids[i], i % 2 == 0 ? 7 : 8);
  }
  parts[0].rows[2] = {1, 7, 0, 1, 0};
  for (const char* const format : kPlyFormats) {
    EXPECT_TRUE(Sample(MakePly(format, parts), WithAttributes({})));
    const auto result = Sample(MakePly(format, parts), WithAttributes({"ids"}));
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().code, ErrorCode::kCorruptInput);
    EXPECT_NE(result.error().message.find("found 1 items in the list 'ids', expected 2"),
              std::string::npos)
        << result.error().message;
  }
}

TEST(PlyAttributes, OfStripsAreTheirVertices) {
  const std::vector<PlyPart> parts = {
      {"vertex",
       {"float x", "float y", "float z", "float quality"},
       {{0, 0, 0, 0}, {1, 0, 0, 2}, {0, 1, 0, 0}, {1, 1, 0, 2}, {0, 2, 0, 0}, {1, 2, 0, 2}}},
      {"tristrips", {"list int int vertex_indices"}, {{9, 0, 1, 2, 3, -1, 4, 2, 3, 5}}}};
  for (const char* const format : kPlyFormats) {
    const auto result = Sample(MakePly(format, parts), WithAttributes({"quality"}));
    ASSERT_TRUE(result) << result.error().message;
    const auto quality = Column<float>(*result, "quality");
    EXPECT_GT(result->stats.sampled, 2u);
    for (std::size_t i = 0; i < quality.size(); ++i) {
      EXPECT_NEAR(quality[i], 2 * result->samples.position[i].x, 1e-6);
    }
  }
}

TEST(PlyAttributes, SkippedFacesUseUpTheirNumbers) {
  auto parts = Sheet(true);
  auto& rows = parts[1].rows;
  rows.insert(rows.begin() + 3, {9, 2, 0, 1, 0});
  rows.insert(rows.begin() + 7, {9, 5, 0, 1, 2, 3, 99999, 0});
  rows.insert(rows.begin(), {9, 0, 0});
  for (const char* const format : kPlyFormats) {
    const auto result = Sample(MakePly(format, parts), WithAttributes({"all"}));
    ASSERT_TRUE(result) << result.error().message;
    EXPECT_EQ(result->stats.skipped[0], 3u);
    EXPECT_EQ(result->stats.skipped[1], 2u);
    ExpectSheet(*result);
  }
}

TEST(PlyAttributes, UniformSamplesCarryThemToo) {
  Options options = WithAttributes({"all"});
  options.method = Method::kUniform;
  options.count = 3000;
  const auto result = Sample(MakePly("binary_big_endian", Sheet(true)), options);
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->samples.size(), 3000u);
  ExpectSheet(*result);
}

TEST(PlyAttributes, AMissingOneIsFoundBeforeAnyWork) {
  const auto result = Sample(MakePly("ascii", Sheet(true)), WithAttributes({"labels"}));
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  EXPECT_NE(result.error().message.find("'labels' is not there; the mesh carries: color (4 x"),
            std::string::npos)
      << result.error().message;
}

}  // namespace
}  // namespace strata::io
