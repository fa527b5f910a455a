// GLB files: every number where the file says it is, and the Khronos validator's word on the whole.
#include <gtest/gtest.h>
#include <stdio.h>
#include <sys/wait.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "io/sample_writer.h"
#include "io/srgb.h"
#include "tests/support/mesh_attribute.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using nlohmann::json;
using test::HeaderFor;
using test::MakeAttribute;
using test::MessageOf;
using test::RandomSamples;
using test::TempFolder;

struct Glb {
  json document;
  std::string binary;
};

std::uint32_t WordAt(const std::string& bytes, std::size_t at) {
  std::uint32_t word;
  std::memcpy(&word, bytes.data() + at, sizeof word);
  return word;
}

Glb Parse(const std::string& file) {
  Glb glb;
  EXPECT_EQ(file.substr(0, 4), "glTF");
  EXPECT_EQ(WordAt(file, 4), 2u);
  EXPECT_EQ(WordAt(file, 8), file.size());
  const std::uint32_t length = WordAt(file, 12);
  EXPECT_EQ(file.substr(16, 4), "JSON");
  glb.document = json::parse(file.substr(20, length));
  EXPECT_EQ(WordAt(file, 20 + length), file.size() - 28 - length);
  EXPECT_EQ(file.substr(24 + length, 4), std::string("BIN\0", 4));
  glb.binary = file.substr(28 + length);
  return glb;
}

// Component `k` of sample `i` in an attribute.
template <class T>
T At(const Glb& glb, const std::string& name, std::size_t i, std::size_t k = 0) {
  const auto& attributes = glb.document["meshes"][0]["primitives"][0]["attributes"];
  const auto& view = glb.document["bufferViews"][attributes.at(name).get<std::size_t>()];
  T value;
  std::memcpy(&value,
              glb.binary.data() + view["byteOffset"].get<std::size_t>() +
                  i * view["byteStride"].get<std::size_t>() + k * sizeof(T),
              sizeof(T));
  return value;
}

struct Written {
  SampleColumns samples;
  SampleHeader header;
  std::string file;
};

Written Write(const TempFolder& folder) {
  Written w;
  w.samples = RandomSamples(300, 12, 0.125, {1e6, -2e6, 5});
  w.header = HeaderFor(w.samples, kAllAttributes);
  auto& columns = w.header.carried;
  columns = {MakeAttribute("color", ScalarType::kUint8, 4, Semantic::kColor),
             MakeAttribute("uv", ScalarType::kFloat64, 2, Semantic::kUv),
             MakeAttribute("label", ScalarType::kInt32, 1),
             MakeAttribute("key", ScalarType::kUint64, 2),
             MakeAttribute("small", ScalarType::kInt8, 3),
             MakeAttribute("many", ScalarType::kFloat32, 6),
             MakeAttribute("light", ScalarType::kFloat32, 3, Semantic::kColor),
             MakeAttribute("material", ScalarType::kUint16, 1, Semantic::kMaterial),
             MakeAttribute("texture", ScalarType::kUint8, 3, Semantic::kTexture)};
  columns[0].color_space = ColorSpace::kSrgb;
  columns[0].normalized = true;
  columns[6].color_space = ColorSpace::kLinear;
  columns[7].names = {"oak", "ash"};
  columns[8].color_space = ColorSpace::kSrgb;
  std::mt19937_64 random(5);
  for (const MeshAttribute& column : columns) {
    std::vector<char>& bytes = w.samples.carried.emplace_back(300 * column.bytes());
    for (char& b : bytes) b = static_cast<char>(random());
    for (std::size_t i = 0; !IsInteger(column.type) && i < bytes.size(); i += SizeOf(column.type)) {
      const double unit = static_cast<double>(random() >> 11) * 0x1p-53;
      const auto single = static_cast<float>(unit);
      column.type == ScalarType::kFloat64 ? std::memcpy(&bytes[i], &unit, sizeof unit)
                                          : std::memcpy(&bytes[i], &single, sizeof single);
    }
  }
  auto writer = OpenSampleWriter(folder / "a.glb", SampleFormat::kGlb, w.header);
  EXPECT_TRUE(writer) << MessageOf(writer);
  EXPECT_TRUE((*writer)->Write(w.samples));
  const auto size = (*writer)->Finish();
  EXPECT_TRUE(size) << MessageOf(size);
  w.file = test::ReadFile(folder / "a.glb");
  EXPECT_EQ(*size, w.file.size());
  return w;
}

TEST(GlbWriter, HoldsEveryColumn) {
  const TempFolder folder;
  const Written w = Write(folder);
  const Glb glb = Parse(w.file);
  EXPECT_EQ(glb.document["meshes"][0]["primitives"][0]["mode"], 0);
  EXPECT_EQ(glb.document["extras"]["strata"], json::parse(test::kProvenance));
  EXPECT_EQ(glb.document["extras"]["names"]["material"], (json{"oak", "ash"}));
  const auto& center = glb.document["nodes"][0]["translation"];
  const SampleColumns& s = w.samples;
  for (std::size_t i = 0; i < s.size(); ++i) {
    for (int a = 0; a < 3; ++a) {
      const auto k = static_cast<std::size_t>(a);
      EXPECT_NEAR(center[k].get<double>() + static_cast<double>(At<float>(glb, "POSITION", i, k)),
                  s.position[i][a], 1e-6);
    }
    EXPECT_EQ(At<float>(glb, "NORMAL", i, 1), s.normal[i].y);
    EXPECT_EQ(At<std::uint64_t>(glb, "_TRIANGLE", i), s.triangle[i]);
    EXPECT_EQ(At<std::int32_t>(glb, "_CELL_Y", i), s.cell[i].y);
    EXPECT_EQ(At<float>(glb, "_AREA", i), static_cast<float>(s.area[i]));
    EXPECT_EQ(At<float>(glb, "_WEIGHT", i), static_cast<float>(s.weight[i]));
    EXPECT_EQ(At<float>(glb, "_BARYCENTRIC", i, 2), static_cast<float>(s.barycentric[i][2]));
    const auto is = [&](std::size_t column, std::size_t at, const auto& value) {
      return std::memcmp(&s.carried[column][at], &value, sizeof value) == 0;
    };
    const std::size_t n = i;
    EXPECT_TRUE(is(2, 4 * n, At<std::int32_t>(glb, "_LABEL", i)));
    EXPECT_TRUE(is(3, 16 * n + 8, At<std::uint64_t>(glb, "_KEY_1", i)));
    EXPECT_TRUE(is(4, 3 * n + 2, At<std::int8_t>(glb, "_SMALL", i, 2)));
    EXPECT_TRUE(is(5, 24 * n + 20, At<float>(glb, "_MANY_5", i)));
    EXPECT_TRUE(is(7, 2 * n, At<std::uint16_t>(glb, "_MATERIAL", i)));
    double u;
    std::memcpy(&u, &s.carried[1][16 * n], sizeof u);
    EXPECT_EQ(At<float>(glb, "TEXCOORD_0", i), static_cast<float>(u));
  }
}

// As glTF wants it: COLOR_n is light, although PLY's colours are encoded for display.
TEST(GlbWriter, TurnsColoursIntoLight) {
  const TempFolder folder;
  const Written w = Write(folder);
  const Glb glb = Parse(w.file);
  for (std::size_t i = 0; i < w.samples.size(); ++i) {
    const double red = static_cast<std::uint8_t>(w.samples.carried[0][4 * i]) / 255.0;
    const double alpha = static_cast<std::uint8_t>(w.samples.carried[0][4 * i + 3]) / 255.0;
    const double light = red <= 0.04045 ? red / 12.92 : std::pow((red + 0.055) / 1.055, 2.4);
    EXPECT_NEAR(At<std::uint16_t>(glb, "COLOR_0", i) / 65535.0, light, 1e-5);
    EXPECT_NEAR(At<std::uint16_t>(glb, "COLOR_0", i, 3) / 65535.0, alpha, 1e-5);
    float linear;
    std::memcpy(&linear, &w.samples.carried[6][12 * i], sizeof linear);
    EXPECT_NEAR(At<std::uint16_t>(glb, "COLOR_1", i) / 65535.0, linear, 1e-5);
    const double blue = static_cast<std::uint8_t>(w.samples.carried[8][3 * i + 2]) / 255.0;
    EXPECT_NEAR(At<std::uint16_t>(glb, "COLOR_2", i, 2) / 65535.0, LinearOfSrgb(blue), 1e-5);
  }
}

TEST(GlbWriter, WritesFiniteNumbersAloneAndSaysHowManyWereNot) {
  const TempFolder folder;
  const double inf = HUGE_VAL, nan = std::nan("");
  SampleColumns samples = RandomSamples(3, 12, 0.125, {});
  SampleHeader header = HeaderFor(samples, 0);
  header.carried = {MakeAttribute("uv", ScalarType::kFloat64, 2, Semantic::kUv),
                    MakeAttribute("heat", ScalarType::kFloat32, 1)};
  const std::array<double, 6> uv = {nan, 0.5, -inf, 1e300, 1, 2};
  const std::array<float, 3> heat = {1, 2, 3};
  const auto bytes = [](const auto& numbers) {
    const auto all = std::as_bytes(std::span(numbers));
    const auto* const begin = reinterpret_cast<const char*>(all.data());
    return std::vector<char>(begin, begin + all.size());
  };
  samples.carried = {bytes(uv), bytes(heat)};
  auto writer = OpenSampleWriter(folder / "a.glb", SampleFormat::kGlb, header);
  ASSERT_TRUE(writer) << MessageOf(writer);
  ASSERT_TRUE((*writer)->Write(samples));
  ASSERT_TRUE((*writer)->Finish());
  const Glb glb = Parse(test::ReadFile(folder / "a.glb"));
  constexpr float kMost = std::numeric_limits<float>::max();
  const std::array<float, 6> expected = {0, 0.5f, -kMost, kMost, 1, 2};
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_EQ(At<float>(glb, "TEXCOORD_0", k / 2, k % 2), expected[k]) << "number " << k;
  }
  EXPECT_EQ(glb.document["accessors"][1]["extras"]["not_finite"], 3);
  EXPECT_FALSE(glb.document["accessors"][2].contains("extras"));
}

TEST(GlbWriter, WritesWhatTheKhronosValidatorAccepts) {
  const TempFolder folder;
  Written w = Write(folder);
  const std::string command = std::string("node '") + STRATA_SOURCE_DIR +
                              "/tests/io/glb/validate.mjs' '" + (folder / "a.glb") + "' 2>&1";
  FILE* const pipe = popen(command.c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  std::string text;
  char part[4096];
  while (const std::size_t n = fread(part, 1, sizeof part, pipe)) text.append(part, n);
  const int status = WEXITSTATUS(pclose(pipe));
  if (status == 77 || status == 127) {
    GTEST_SKIP() << "the validator is missing: npm ci in tests/io/glb";
  }
  ASSERT_EQ(status, 0) << text;
  const json report = json::parse(text);
  EXPECT_EQ(report["issues"]["numErrors"], 0) << report.dump(1);
  EXPECT_EQ(report["issues"]["numWarnings"], 0) << report.dump(1);
  EXPECT_EQ(report["info"]["totalVertexCount"], w.samples.size());
}

TEST(GlbWriter, RefusesWhatAGlbCannotCount) {
  const TempFolder folder;
  const SampleColumns samples = RandomSamples(1, 3);
  SampleHeader header = HeaderFor(samples, 0);
  header.count = 400'000'000;
  const auto writer = OpenSampleWriter(folder / "a.glb", SampleFormat::kGlb, header);
  ASSERT_FALSE(writer);
  EXPECT_EQ(writer.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(writer.error().message.find("4 GiB"), std::string::npos) << writer.error().message;
}

}  // namespace
}  // namespace strata::io
