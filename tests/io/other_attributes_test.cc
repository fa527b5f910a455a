// What OBJ, OFF and STL carry reaches their samples.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "core/sample_mesh.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

Result<SampleResult> Sample(const std::string& file, const std::string& name,
                            const std::vector<std::string>& attributes,
                            std::uint64_t budget = MemoryAccount::kUnlimited,
                            ScratchFolder* scratch = nullptr) {
  RunContext context(budget);
  context.SetScratch(scratch);
  auto reader = OpenMesh(MemorySource(file, name));
  if (!reader) return Forward(reader);
  SampleOptions options;
  options.lattice = Resolution{24};
  options.attributes = kTriangle;
  options.mesh_attributes = attributes;
  options.threads = 1;
  options.batch_size = 64;
  return SampleMesh(**reader, options, context);
}

std::string AttributesOf(const std::string& file, const std::string& name) {
  auto reader = OpenMesh(MemorySource(file, name));
  return reader ? Describe((*reader)->attributes()) : reader.error().message;
}

template <class T>
std::vector<T> Column(const SampleResult& result, const std::string& name) {
  for (std::size_t k = 0; k < result.carried.size(); ++k) {
    if (result.carried[k].name != name) continue;
    std::vector<T> values(result.samples.carried[k].size() / sizeof(T));
    std::memcpy(values.data(), result.samples.carried[k].data(), result.samples.carried[k].size());
    return values;
  }
  ADD_FAILURE() << "no column " << name;
  return {};
}

// Two squares side by side: a quad with UVs, and two triangles behind a seam, some without.
const char* const kObj = R"(# a test
mtllib none.mtl
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0 0 1 0
v 0 1 0 1 0 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 2
f 1/1/1 2/2/1 3/3/1 4/4/1
o right half
g a b
usemtl oak
v 2 0 0 0 0 1
v 2 1 0 0 0 1
vt 11 10 0.5
vt 12 10
vt 12 11
vn 1 0 0
f 2/5/1 -2/-2/2 -1/7/2
usemtl say "ash" \
 and more
g c
f 2//1 6//1 3//1
usemtl oak
f 1 2
f 2 9 3
f 2 5 6
)";

TEST(ObjAttributes, ReachTheSamples) {
  EXPECT_EQ(AttributesOf(kObj, "a.obj"),
            "color (3 x float32, vertex), uv (2 x float32, corner), vertex_normal (3 x float32, "
            "corner), group (uint32, triangle), object (uint32, triangle), material (uint32, "
            "triangle), texture (3 x uint8, triangle)");
  for (const bool packed : {false, true}) {
    const auto result = Sample(packed ? test::Gzip(kObj) : kObj, "a.obj", {"all"});
    ASSERT_TRUE(result) << result.error().message;
    const auto color = Column<float>(*result, "color"), uv = Column<float>(*result, "uv"),
               normal = Column<float>(*result, "vertex_normal");
    const auto group = Column<std::uint32_t>(*result, "group"),
               object = Column<std::uint32_t>(*result, "object"),
               material = Column<std::uint32_t>(*result, "material");
    using Names = std::vector<std::string>;
    EXPECT_EQ(result->carried[3].names, (Names{"default", "a b", "c"}));
    EXPECT_EQ(result->carried[4].names, (Names{"default", "right half"}));
    EXPECT_EQ(result->carried[5].names.size(), 3u);
    EXPECT_EQ(result->carried[5].names[2].substr(0, 9), "say \"ash\"");
    bool seen[7] = {};
    for (std::size_t i = 0; i < result->samples.size(); ++i) {
      const Vec3 p = result->samples.position[i];
      const std::uint64_t t = result->samples.triangle[i];
      ASSERT_LT(t, 7u);
      seen[t] = true;
      EXPECT_NEAR(color[3 * i], std::max(0.0, 1 - p.x), 1e-6);
      EXPECT_NEAR(color[3 * i + 2], std::max(0.0, p.x - 1), 1e-6);
      if (t < 2) {  // The quad.
        EXPECT_NEAR(uv[2 * i], p.x, 1e-6);
        EXPECT_NEAR(uv[2 * i + 1], p.y, 1e-6);
        EXPECT_EQ(normal[3 * i + 2], 2);
        EXPECT_EQ(group[i] + object[i] + material[i], 0u);
      } else if (t == 2) {
        EXPECT_NEAR(uv[2 * i], p.x + 10, 1e-5);
        EXPECT_NEAR(uv[2 * i + 1], p.y + 10, 1e-5);
        EXPECT_EQ(group[i], 1u);
        EXPECT_EQ(object[i], 1u);
        EXPECT_EQ(material[i], 1u);
      } else {
        EXPECT_TRUE(std::isnan(uv[2 * i]));
        EXPECT_EQ(group[i], 2u);
        EXPECT_EQ(material[i], t == 3 ? 2u : 1u);
        EXPECT_EQ(std::isnan(normal[3 * i]), t != 3);
      }
    }
    EXPECT_TRUE(seen[0] && seen[1] && seen[2] && seen[3]);
  }
}

TEST(ObjAttributes, HaveZeroForTheSecondOfAUvThatIsLeftOut) {
  const auto result =
      Sample("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5\nvt 1\nvt 0\nf 1/1 2/2 3/3\n", "a.obj", {"uv"});
  ASSERT_TRUE(result) << result.error().message;
  const auto uv = Column<float>(*result, "uv");
  ASSERT_FALSE(uv.empty());
  for (std::size_t i = 0; 2 * i < uv.size(); ++i) {
    const Vec3 p = result->samples.position[i];
    EXPECT_NEAR(uv[2 * i], 0.5 + p.x / 2 - p.y / 2, 1e-6);
    EXPECT_EQ(uv[2 * i + 1], 0);
  }
}

TEST(ObjAttributes, OfAPlainFileAreNone) {
  EXPECT_EQ(AttributesOf("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj"), "none");
}

TEST(OffAttributes, ReachTheSamples) {
  const std::string bytes =
      "COFF\n4 1 0\n# corners\n0 0 0 255 0 7\n1 0 0 0 0 7\n1 1 0 0 255 7 # last\n0 1 0 255 255 7\n"
      "4 0 1 2 3\n";
  EXPECT_EQ(AttributesOf(bytes, "a.off"), "color (3 x uint8, vertex)");
  const auto small = Sample(bytes, "a.off", {"color"});
  ASSERT_TRUE(small) << small.error().message;
  const auto color = Column<std::uint8_t>(*small, "color");
  for (std::size_t i = 0; i < small->samples.size(); ++i) {
    EXPECT_NEAR(color[3 * i], 255 * (1 - small->samples.position[i].x), 0.51);
    EXPECT_NEAR(color[3 * i + 1], 255 * small->samples.position[i].y, 0.51);
    EXPECT_EQ(color[3 * i + 2], 7);
  }
  const std::string all =
      "STCNOFF 3 2 0\n0 0 0  0 0 1  0.5 0 0 1  0 0\n1 0 0  0 1 0  0.5 1 0 1  1 0\n"
      "0 1 0  1 0 0  0.5 0 1 1  0 1\n2 0 1\n3 0 1 2\n";
  EXPECT_EQ(AttributesOf(all, "a.off"),
            "color (4 x float32, vertex), vertex_normal (3 x float32, vertex), uv (2 x float32, "
            "vertex)");
  const auto result = Sample(all, "a.off", {"all"});
  ASSERT_TRUE(result) << result.error().message;
  const auto shade = Column<float>(*result, "color"), uv = Column<float>(*result, "uv"),
             normal = Column<float>(*result, "vertex_normal");
  for (std::size_t i = 0; i < result->samples.size(); ++i) {
    const Vec3 p = result->samples.position[i];
    EXPECT_EQ(shade[4 * i], 0.5f);
    EXPECT_NEAR(shade[4 * i + 1], p.x, 1e-6);
    EXPECT_NEAR(normal[3 * i], p.y, 1e-6);
    EXPECT_NEAR(uv[2 * i], p.x, 1e-6);
    EXPECT_NEAR(uv[2 * i + 1], p.y, 1e-6);
  }
}

TEST(OffAttributes, OfFacesReachTheSamples) {
  // A square of two triangles behind a quad; the third face has no colour.
  const std::string vertices = "7 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n2 1 0\n3 0 0\n";
  const std::string faces =
      "OFF\n" + vertices + "4 0 1 2 3  255 128 0 7 # a comment\n3 1 4 2 1 2 3 4\n3 4 6 5\n";
  EXPECT_EQ(AttributesOf(faces, "a.off"), "color (4 x uint8, triangle)");
  for (const bool packed : {false, true}) {
    const auto result = Sample(packed ? test::Gzip(faces) : faces, "a.off", {"all"});
    ASSERT_TRUE(result) << result.error().message;
    const auto color = Column<std::uint8_t>(*result, "color");
    const std::vector<std::vector<std::uint8_t>> expected = {
        {255, 128, 0, 7}, {255, 128, 0, 7}, {1, 2, 3, 4}, {0, 0, 0, 0}};
    for (std::size_t i = 0; i < result->samples.size(); ++i) {
      const std::vector<std::uint8_t> found(color.begin() + static_cast<std::ptrdiff_t>(4 * i),
                                            color.begin() + static_cast<std::ptrdiff_t>(4 * i + 4));
      EXPECT_EQ(found, expected[result->samples.triangle[i]]);
    }
  }
}

TEST(OffAttributes, CountTheSameLinesAsTheReader) {
  // A carriage return is a blank where the first line ends with none.
  const std::string file =
      "COFF\n3 2 0\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n1 0 \r2 1 0\n3 2 1 0\n";
  const auto result = Sample(file, "a.off", {"color"});
  ASSERT_TRUE(result) << result.error().message;
  for (const std::uint8_t value : Column<std::uint8_t>(*result, "color")) {
    EXPECT_TRUE(value == 0 || value == 255) << int{value};
  }
}

TEST(OffAttributes, OfFacesAndVerticesAreTold) {
  const auto with = [](const std::string& head, const std::string& tail) {
    return AttributesOf(
        head + "\n3 1 0\n0 0 0 1 0 0\n1 0 0 0 1 0\n0 1 0 0 0 1\n3 0 1 2 " + tail + "\n", "a.off");
  };
  EXPECT_EQ(with("COFF", "0.5 0.5 0.25"),
            "color (3 x uint8, vertex), face_color (3 x float32, triangle)");
  EXPECT_EQ(with("OFF", "17"), "color_index (int32, triangle)");
  EXPECT_EQ(with("OFF", "17 18"), "none");
  EXPECT_EQ(with("OFF", "# 1 2 3"), "none");
  const auto index = Sample("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 17\n", "a.off", {"all"});
  ASSERT_TRUE(index) << index.error().message;
  EXPECT_EQ(Column<std::int32_t>(*index, "color_index")[0], 17);
}

// Facets side by side, with these attribute bytes.
std::string MakeStl(const std::string& head, const std::vector<std::uint16_t>& attributes) {
  std::string file = head;
  file.resize(80, ' ');
  const auto append = [&](auto value) {
    file.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  append(static_cast<std::uint32_t>(attributes.size()));
  for (std::size_t i = 0; i < attributes.size(); ++i) {
    const float x = static_cast<float>(i);
    for (const float v : {0.f, 0.f, 1.f, x, 0.f, 0.f, x + 1, 0.f, 0.f, x, 1.f, 0.f}) append(v);
    append(attributes[i]);
  }
  return file;
}

TEST(StlAttributes, AreTheirBytesAndTheColoursInThem) {
  const std::vector<std::uint16_t> words = {0x8000 | 31 << 10, 0x8000 | 31, 17, 0xffff};
  const std::string viscam = MakeStl("binary", words);
  std::string magics_head = "binary COLOR=";
  magics_head += "\x10\x20\x30\xff";
  const std::string magics = MakeStl(magics_head, {31, 31 << 10, 0x8001, 31 << 5});
  EXPECT_EQ(AttributesOf(MakeStl("binary", {1, 2}), "a.stl"), "attribute (uint16, triangle)");
  using Rgb = std::array<int, 3>;
  const Rgb of_viscam[] = {{255, 0, 0}, {0, 0, 255}, {0, 0, 0}, {255, 255, 255}};
  const Rgb of_magics[] = {{255, 0, 0}, {0, 0, 255}, {0x10, 0x20, 0x30}, {0, 255, 0}};
  for (const bool first : {true, false}) {
    for (const bool packed : {false, true}) {
      const std::string& file = first ? viscam : magics;
      EXPECT_EQ(AttributesOf(file, "a.stl"),
                "attribute (uint16, triangle), color (3 x uint8, triangle)");
      const auto result = Sample(packed ? test::Gzip(file) : file, "a.stl", {"all"});
      ASSERT_TRUE(result) << result.error().message;
      const auto color = Column<std::uint8_t>(*result, "color");
      const auto attribute = Column<std::uint16_t>(*result, "attribute");
      for (std::size_t i = 0; i < result->samples.size(); ++i) {
        const std::uint64_t t = result->samples.triangle[i];
        const Rgb expected = first ? of_viscam[t] : of_magics[t];
        EXPECT_EQ((Rgb{color[3 * i], color[3 * i + 1], color[3 * i + 2]}), expected);
        if (first) {
          EXPECT_EQ(attribute[i], words[t]);
        }
      }
    }
  }
}

TEST(ObjAttributes, GiveTheSameWithinABudget) {
  std::string file;
  constexpr int kSide = 80;
  for (int j = 0; j <= kSide; ++j) {
    for (int i = 0; i <= kSide; ++i) {
      file += "v " + std::to_string(i) + " " + std::to_string(j) + " 0\nvt " +
              std::to_string(i * 0.25) + " " + std::to_string(j * 0.5) + "\n";
    }
  }
  for (int j = 0; j < kSide; ++j) {
    file += "g row" + std::to_string(j) + "\n";
    for (int i = 0; i < kSide; ++i) {
      const int a = j * (kSide + 1) + i + 1, b = a + 1, d = a + kSide + 1, c = d + 1;
      file += "f";
      for (const int k : {a, b, c, d}) file += " " + std::to_string(k) + "/" + std::to_string(k);
      file += "\n";
    }
  }
  const test::TempFolder folder;
  const auto scratch = ScratchFolder::Open(folder.path());
  const auto expected = Sample(file, "a.obj", {"all"});
  const auto result = Sample(file, "a.obj", {"all"}, std::uint64_t{40} << 20, scratch->get());
  ASSERT_TRUE(expected && result) << result.error().message;
  EXPECT_EQ(expected->samples.carried, result->samples.carried);
  const auto uv = Column<float>(*expected, "uv");
  const auto group = Column<std::uint32_t>(*expected, "group");
  for (std::size_t i = 0; i < expected->samples.size(); ++i) {
    const Vec3 p = expected->samples.position[i];
    EXPECT_NEAR(uv[2 * i], p.x * 0.25, 1e-5);
    EXPECT_EQ(expected->carried[1].names[group[i]], "row" + std::to_string(static_cast<int>(p.y)));
  }
}

}  // namespace
}  // namespace strata::io
