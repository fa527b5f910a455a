#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/sample_mesh.h"
#include "io/base_color.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "io/srgb.h"
#include "io/texture_sampler.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/image_maker.h"
#include "tests/support/temp_folder.h"
#include "tests/support/zip_maker.h"

namespace strata::io {
namespace {

using test::GltfMaker;
using test::MakePixels;
using test::MakePng;
using test::Pixels;
using test::UvPixels;
using Json = GltfMaker::Json;
using Rgb = std::array<int, 3>;

// --- What an image is at a place -----------------------------------------------------------------

// A row of greys: 0, 80, 160, 240.
Image Greys() {
  auto image =
      DecodeImage(MakePng(MakePixels(4, 1, 1, [](unsigned x, unsigned, int) { return x * 80; })),
                  "greys", nullptr);
  EXPECT_TRUE(image);
  return std::move(*image);
}

int GreyAt(const Image& image, Wrap wrap, bool nearest, double u) {
  return Srgb8OfLinear(LookUp(image, {wrap, wrap, nearest}, u, 0.5)[0]);
}

TEST(LookUp, OfTheNearestPixelWrapsAsItIsTold) {
  const Image image = Greys();
  const struct {
    double u;
    int repeat, mirror, clamp;
  } cases[] = {{0.1, 0, 0, 0},      {0.3, 80, 80, 80},   {0.99, 240, 240, 240}, {1.0, 0, 240, 240},
               {1.3, 80, 160, 240}, {-0.1, 240, 0, 0},   {-0.3, 160, 80, 0},    {-1.1, 240, 240, 0},
               {2.1, 0, 0, 240},    {5.3, 80, 160, 240}, {-1e300, 0, 0, 0},     {1e300, 0, 0, 240}};
  for (const auto& c : cases) {
    EXPECT_EQ(GreyAt(image, Wrap::kRepeat, true, c.u), c.repeat) << "repeated at " << c.u;
    EXPECT_EQ(GreyAt(image, Wrap::kMirror, true, c.u), c.mirror) << "mirrored at " << c.u;
    EXPECT_EQ(GreyAt(image, Wrap::kClamp, true, c.u), c.clamp) << "clamped at " << c.u;
  }
}

TEST(LookUp, OfFourPixelsIsExactInTheirMiddlesAndMixesLightBetween) {
  const Image image = Greys();
  for (const Wrap wrap : {Wrap::kRepeat, Wrap::kMirror, Wrap::kClamp}) {
    for (int x = 0; x < 4; ++x) EXPECT_EQ(GreyAt(image, wrap, false, (x + 0.5) / 4), x * 80);
  }
  const auto mixed = [](int a, int b) {
    return Srgb8OfLinear((LinearOfSrgb(a / 255.0) + LinearOfSrgb(b / 255.0)) / 2);
  };
  EXPECT_EQ(GreyAt(image, Wrap::kRepeat, false, 0.5), mixed(80, 160));
  EXPECT_EQ(GreyAt(image, Wrap::kRepeat, false, 0), mixed(0, 240));
  EXPECT_EQ(GreyAt(image, Wrap::kMirror, false, 0), 0);
  EXPECT_EQ(GreyAt(image, Wrap::kMirror, false, 1), 240);
  EXPECT_EQ(GreyAt(image, Wrap::kClamp, false, 1), 240);
  EXPECT_EQ(GreyAt(image, Wrap::kMirror, false, 1.5), mixed(80, 160));
}

TEST(Srgb, GoesToLightAndBackToEveryCode) {
  for (int k = 0; k < 256; ++k) {
    const double light = LinearOfSrgb8()[k];
    EXPECT_EQ(Srgb8OfLinear(light), k);
    const double c = k / 255.0;
    const double expected = c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
    EXPECT_NEAR(light, expected, 1e-14) << k;
  }
  EXPECT_EQ(Srgb8OfLinear(-1), 0);
  EXPECT_EQ(Srgb8OfLinear(2), 255);
  EXPECT_EQ(Srgb8OfLinear(std::nan("")), 0);
}

// The extension's own example: the lower left quadrant of the image, turned.
TEST(UvTransform, TurnsAsTheExtensionsExampleSays) {
  const auto transform = UvTransform::FromTrs({0, 1}, 1.57079632679, {0.5, 0.5});
  const auto at = [&](double u, double v) {
    const auto& m = transform.m;
    return std::array{m[0] * u + m[1] * v + m[2], m[3] * u + m[4] * v + m[5]};
  };
  const struct {
    double u, v, x, y;
  } corners[] = {{0, 0, 0, 1}, {1, 0, 0, 0.5}, {0, 1, 0.5, 1}, {1, 1, 0.5, 0.5}};
  for (const auto& c : corners) {
    EXPECT_NEAR(at(c.u, c.v)[0], c.x, 1e-9);
    EXPECT_NEAR(at(c.u, c.v)[1], c.y, 1e-9);
  }
}

// --- Meshes --------------------------------------------------------------------------------------

using Attributes = std::vector<std::string>;

Result<SampleResult> Sampled(MeshReader& reader, const Attributes& wanted, int threads = 1,
                             std::uint64_t memory = MemoryAccount::kUnlimited) {
  SampleOptions options;
  options.lattice = Resolution{24};
  options.min_distance = 0;
  options.mesh_attributes = wanted;
  options.threads = threads;
  RunContext context(memory);
  return SampleMesh(reader, options, context);
}

Result<SampleResult> Sampled(const std::string& bytes, const Attributes& wanted) {
  auto reader = OpenMesh(MemorySource(bytes));
  if (!reader) return Forward(reader);
  return Sampled(**reader, wanted);
}

std::size_t ColumnOf(const SampleResult& result, const std::string& name) {
  for (std::size_t k = 0; k < result.carried.size(); ++k) {
    if (result.carried[k].name == name) return k;
  }
  ADD_FAILURE() << "no column " << name << " among " << Describe(result.carried);
  return 0;
}

Rgb ColorOf(const SampleResult& result, std::size_t i) {
  const std::size_t k = ColumnOf(result, "texture");
  const char* const at = result.samples.carried[k].data() + i * result.carried[k].bytes();
  return {static_cast<unsigned char>(at[0]), static_cast<unsigned char>(at[1]),
          static_cast<unsigned char>(at[2])};
}

// The distance of the samples' colours from what `expected(position)` says, at most, in any
// channel.
double Furthest(const SampleResult& result,
                const std::function<std::array<double, 3>(Vec3)>& expected) {
  EXPECT_GT(result.samples.size(), 100u);
  double furthest = 0;
  for (std::size_t i = 0; i < result.samples.size(); ++i) {
    const Rgb found = ColorOf(result, i);
    const auto color = expected(result.samples.position[i]);
    for (std::size_t c = 0; c < 3; ++c)
      furthest = std::max(furthest, std::fabs(found[c] - color[c]));
  }
  return furthest;
}

// What UvPixels is at a coordinate, if it is clamped.
double Code(double coordinate) { return std::clamp(coordinate * 256 - 0.5, 0.0, 255.0); }

int AddImage(GltfMaker& maker, const std::string& bytes, const char* type = "image/png") {
  const int view = maker.View(std::vector<char>(bytes.begin(), bytes.end()));
  maker.json["images"].push_back({{"bufferView", view}, {"mimeType", type}});
  return static_cast<int>(maker.json["images"].size()) - 1;
}

constexpr int kClamp = 33071, kMirrored = 33648, kNearest = 9728;

// The unit square with u = x and v = y, one material whose texture has this image, clamped.
GltfMaker Square(const std::string& image,
                 const std::vector<float>& uv = {0, 0, 1, 0, 1, 1, 0, 1}) {
  GltfMaker maker;
  const int positions = maker.Floats3({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0});
  const int uvs = maker.Values(uv, "VEC2", 2, 5126);
  Json& primitive = maker.Primitive(positions, maker.Indices({0, 1, 2, 0, 2, 3}));
  primitive["attributes"]["TEXCOORD_0"] = uvs;
  primitive["material"] = 0;
  maker.json["materials"] = {
      {{"name", "paint"}, {"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}}}}}}};
  maker.json["samplers"] = {{{"wrapS", kClamp}, {"wrapT", kClamp}}};
  maker.json["textures"] = {{{"source", AddImage(maker, image)}, {"sampler", 0}}};
  return maker;
}

TEST(Texture, OfAGltfIsTheColourAtEachSamplesUv) {
  const auto result = Sampled(Square(MakePng(UvPixels())).Glb(), {"texture", "uv"});
  ASSERT_TRUE(result) << result.error().message;
  const MeshAttribute& column = result->carried[ColumnOf(*result, "texture")];
  EXPECT_EQ(column.type, ScalarType::kUint8);
  EXPECT_EQ(column.components, 3);
  EXPECT_EQ(column.semantic, Semantic::kTexture);
  EXPECT_EQ(column.color_space, ColorSpace::kSrgb);
  const auto expected = [](Vec3 p) { return std::array{Code(p.x), Code(p.y), 0.0}; };
  EXPECT_LE(Furthest(*result, expected), 1);
  // And by what the samples carry of texture coordinates.
  const std::vector<char>& uvs = result->samples.carried[ColumnOf(*result, "uv")];
  for (std::size_t i = 0; i < result->samples.size(); ++i) {
    float uv[2];
    std::memcpy(uv, uvs.data() + i * sizeof uv, sizeof uv);
    EXPECT_NEAR(ColorOf(*result, i)[0], Code(static_cast<double>(uv[0])), 1);
    EXPECT_NEAR(ColorOf(*result, i)[1], Code(static_cast<double>(uv[1])), 1);
  }
}

TEST(Texture, IsReadFromEveryTypeOfImage) {
  const Pixels wide = MakePixels(
      256, 256, 3,
      [](unsigned x, unsigned y, int c) { return c == 0   ? x * 257
                                                 : c == 1 ? y * 257
                                                          : 0; }, 16);
  test::JpegShape progressive;
  progressive.progressive = true;
  const struct {
    const char* what;
    std::string bytes;
    double most;
  } cases[] = {{"8 bits", MakePng(UvPixels()), 1},
               {"16 bits", MakePng(wide), 1},
               {"interlaced", MakePng(UvPixels(), {true, {}}), 1},
               {"webp", test::MakeWebp(UvPixels()), 1},
               {"lossy webp", test::MakeWebp(UvPixels(), false), 9},
               {"jpeg", test::MakeJpeg(UvPixels()), 4},
               {"progressive jpeg", test::MakeJpeg(UvPixels(), progressive), 4}};
  for (const auto& c : cases) {
    const auto result = Sampled(Square(c.bytes).Text(), {"texture"});
    ASSERT_TRUE(result) << c.what << ": " << result.error().message;
    const auto expected = [](Vec3 p) { return std::array{Code(p.x), Code(p.y), 0.0}; };
    EXPECT_LE(Furthest(*result, expected), c.most) << c.what;
  }
}

TEST(Texture, IsMirroredRepeatedAndTakenFromTheNearestPixel) {
  // Coordinates from -1 to 2 across the square.
  GltfMaker maker = Square(MakePng(UvPixels()), {-1, 0, 2, 0, 2, 1, -1, 1});
  maker.json["samplers"][0] = {{"wrapS", kMirrored}, {"wrapT", kClamp}};
  const auto mirrored = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(mirrored) << mirrored.error().message;
  const auto within = [](Vec3 p) {
    const double u = 3 * p.x - 1, folded = std::fabs(u - 2 * std::round(u / 2));
    return std::array{Code(folded), Code(p.y), 0.0};
  };
  EXPECT_LE(Furthest(*mirrored, within), 1);
  maker.json["samplers"][0] = {{"magFilter", kNearest}};
  const auto nearest = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(nearest) << nearest.error().message;
  const auto floor = [](Vec3 p) {
    const double u = 3 * p.x - 1;
    return std::array{std::floor((u - std::floor(u)) * 256), std::floor(p.y * 256), 0.0};
  };
  // At a border between pixels rounding decides, and at a border of the image by all of it.
  int others = 0;
  for (std::size_t i = 0; i < nearest->samples.size(); ++i) {
    const auto color = floor(nearest->samples.position[i]);
    const Rgb found = ColorOf(*nearest, i);
    others += found[0] != static_cast<int>(color[0]) || found[1] != static_cast<int>(color[1]);
  }
  EXPECT_LE(others, 1);
}

TEST(Texture, IsTransformedAndMayHaveCoordinatesOfItsOwn) {
  GltfMaker maker = Square(MakePng(UvPixels()), {9, 9, 9, 9, 9, 9, 9, 9});
  const int uvs = maker.Values(std::vector<float>{0, 0, 1, 0, 1, 1, 0, 1}, "VEC2", 2, 5126);
  maker.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = uvs;
  const double angle = 0.5;
  maker.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
      {"KHR_texture_transform",
       {{"offset", {0.1, 0.4}}, {"rotation", angle}, {"scale", {0.5, 0.25}}, {"texCoord", 1}}}};
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(result) << result.error().message;
  const auto expected = [&](Vec3 p) {
    const double u = 0.5 * p.x, v = 0.25 * p.y, c = std::cos(angle), s = std::sin(angle);
    return std::array{Code(0.1 + c * u + s * v), Code(0.4 - s * u + c * v), 0.0};
  };
  EXPECT_LE(Furthest(*result, expected), 1);
}

TEST(Texture, IsMultipliedWithTheFactorAsLight) {
  GltfMaker maker = Square(MakePng(MakePixels(1, 1, 3, [](unsigned, unsigned, int c) {
    return c == 0 ? 255u : c == 1 ? 128u : 40u;
  })));
  maker.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {0.5, 0.25, 1, 0.3};
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(result) << result.error().message;
  const Rgb expected = {Srgb8OfLinear(0.5), Srgb8OfLinear(0.25 * LinearOfSrgb(128 / 255.0)), 40};
  for (std::size_t i = 0; i < result->samples.size(); ++i) EXPECT_EQ(ColorOf(*result, i), expected);
}

TEST(Texture, HasAlphaWhereAMaterialIsNotOpaque) {
  GltfMaker maker = Square(
      MakePng(MakePixels(1, 1, 4, [](unsigned, unsigned, int c) { return c == 3 ? 100u : 9u; })));
  const auto opaque = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(opaque) << opaque.error().message;
  EXPECT_EQ(opaque->carried[0].components, 3);
  maker.json["materials"][0]["alphaMode"] = "BLEND";
  maker.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {1, 1, 1, 0.5};
  const auto blended = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(blended) << blended.error().message;
  ASSERT_EQ(blended->carried[0].components, 4);
  EXPECT_EQ(static_cast<unsigned char>(blended->samples.carried[0][3]), 50);
}

TEST(Texture, OfMaterialsWithoutIsTheFactorAndWithoutMaterialWhite) {
  GltfMaker maker = Square(MakePng(UvPixels()));
  maker.json["materials"].push_back(
      {{"pbrMetallicRoughness", {{"baseColorFactor", {0.5, 0, 1, 1}}}}});
  const Json square = maker.json["meshes"][0]["primitives"][0];
  for (const int n : {1, 2}) {
    Json other = square;
    const float z = static_cast<float>(n);
    other["attributes"]["POSITION"] = maker.Floats3({0, 0, z, 1, 0, z, 1, 1, z, 0, 1, z});
    if (n == 1) other["material"] = 1;
    if (n == 2) other.erase("material");
    maker.json["meshes"][0]["primitives"].push_back(other);
  }
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(result) << result.error().message;
  const auto expected = [](Vec3 p) -> std::array<double, 3> {
    if (p.z < 0.5) return {Code(p.x), Code(p.y), 0};
    if (p.z < 1.5) return {static_cast<double>(Srgb8OfLinear(0.5)), 0, 255};
    return {255, 255, 255};
  };
  EXPECT_LE(Furthest(*result, expected), 1);
}

TEST(Texture, PrefersWebpAndTheOlderExtensionsDiffuseColour) {
  GltfMaker maker =
      Square(MakePng(MakePixels(1, 1, 3, [](unsigned, unsigned, int) { return 1u; })));
  const int webp = AddImage(maker, test::MakeWebp(UvPixels()), "image/webp");
  maker.json["textures"][0]["extensions"]["EXT_texture_webp"]["source"] = webp;
  maker.json["materials"][0] = {
      {"extensions",
       {{"KHR_materials_pbrSpecularGlossiness", {{"diffuseTexture", {{"index", 0}}}}}}}};
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_TRUE(result) << result.error().message;
  const auto expected = [](Vec3 p) { return std::array{Code(p.x), Code(p.y), 0.0}; };
  EXPECT_LE(Furthest(*result, expected), 1);
}

TEST(Texture, ThatIsDamagedIsNoMatterOfTheSurface) {
  GltfMaker maker = Square(MakePng(UvPixels()));
  maker.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"] = 7;
  ASSERT_TRUE(Sampled(maker.Glb(), {}));
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kCorruptInput);
  EXPECT_NE(result.error().message.find(
                "/materials/0/pbrMetallicRoughness/baseColorTexture/index: found index 7 of 1"),
            std::string::npos)
      << result.error().message;
  maker = Square(MakePng(UvPixels()).substr(0, 300));
  ASSERT_TRUE(Sampled(maker.Glb(), {"uv"}));
  const auto cut = Sampled(maker.Glb(), {"texture"});
  ASSERT_FALSE(cut);
  EXPECT_EQ(cut.error().code, ErrorCode::kCorruptInput);
  EXPECT_NE(cut.error().message.find("/images/0"), std::string::npos) << cut.error().message;
}

TEST(Texture, ThatIsAskedForAndNotThereIsAnErrorThatListsWhatIs) {
  GltfMaker maker = Square(MakePng(UvPixels()));
  maker.json.erase("materials");
  const auto result = Sampled(maker.Glb(), {"texture"});
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  EXPECT_NE(result.error().message.find("uv"), std::string::npos) << result.error().message;
}

// --- OBJ -----------------------------------------------------------------------------------------

// Three squares side by side: textured with v up, and seams where they meet; tinted; without any.
const std::string kObj =
    "mtllib m.mtl\n"
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nv 3 0 0\nv 3 1 0\n"
    "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    "usemtl paint\nf 1/1 2/2 3/3 4/4\n"
    "usemtl tint\nf 2/1 5/2 6/3 3/4\n"
    "usemtl plain\nf 5 7 8 6\n";
const std::string kMtl =
    "newmtl paint\nKd 1 1 1\nmap_Kd -clamp on -bm 0.5 -imfchan l uv.png\n"
    "newmtl tint\nKd 0 0.5 1\nmap_kd -s 0.5 0.5 1 -o 0.25 0 -clamp on uv.png\n"
    "newmtl plain\nKd 0.2 0.4 0.6\n";

std::array<double, 3> ExpectedOfObj(Vec3 p) {
  if (p.x < 1) return {Code(p.x), Code(1 - p.y), 0};
  if (p.x >= 2) return {51, 102, 153};
  const double green = LinearOfSrgb(Code(1 - p.y * 0.5) / 255) * LinearOfSrgb(0.5);
  return {0, static_cast<double>(Srgb8OfLinear(green)), 0};
}

class ObjTexture : public testing::Test {
 protected:
  ObjTexture() {
    test::WriteFile(folder_ / "m.obj", kObj);
    test::WriteFile(folder_ / "m.mtl", kMtl);
    test::WriteFile(folder_ / "uv.png", MakePng(UvPixels()));
  }
  Result<SampleResult> Sample(const Attributes& wanted, const std::string& name = "m.obj") {
    auto reader = OpenMesh(folder_ / name);
    if (!reader) return Forward(reader);
    return Sampled(**reader, wanted);
  }
  test::TempFolder folder_;
};

TEST_F(ObjTexture, HasItsOriginBelowAndIsTintedByTheDiffuseColour) {
  const auto result = Sample({"texture", "material"});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_LE(Furthest(*result, ExpectedOfObj), 1);
}

TEST_F(ObjTexture, IsFoundInTheSameArchive) {
  test::WriteFile(
      folder_ / "m.zip",
      test::MakeZip({{"in/m.obj", kObj}, {"in/m.mtl", kMtl}, {"in/uv.png", MakePng(UvPixels())}}));
  const auto beside = Sample({"texture"}), inside = Sample({"texture"}, "m.zip");
  ASSERT_TRUE(inside) << inside.error().message;
  EXPECT_EQ(inside->samples.carried, beside->samples.carried);
}

TEST_F(ObjTexture, ThatIsMissingIsNamedIfItWasAskedForByName) {
  std::filesystem::remove(folder_ / "uv.png");
  ASSERT_TRUE(Sample({"material"}));
  const auto named = Sample({"texture"});
  ASSERT_FALSE(named);
  EXPECT_EQ(named.error().code, ErrorCode::kNotFound);
  EXPECT_NE(named.error().message.find("the file 'uv.png'"), std::string::npos)
      << named.error().message;
  const auto all = Sample({"all"});
  ASSERT_TRUE(all) << all.error().message;
  EXPECT_EQ(all->carried.size(), 2u) << Describe(all->carried);
  ASSERT_EQ(all->stats.left_out.size(), 1u);
  EXPECT_NE(all->stats.left_out[0].find("uv.png"), std::string::npos) << all->stats.left_out[0];
  EXPECT_FALSE(Sample({"all", "texture"}));
}

TEST_F(ObjTexture, ThatIsDamagedIsLeftOutByAllAsAMissingOneIs) {
  std::filesystem::remove(folder_ / "uv.png");
  const auto missing = Sample({"all"});
  ASSERT_TRUE(missing) << missing.error().message;
  const std::string png = MakePng(UvPixels());
  // In its head; in its pixels, of which the head knows nothing.
  for (const std::size_t bytes : {std::size_t{20}, std::size_t{300}, png.size() - 20}) {
    test::WriteFile(folder_ / "uv.png", png.substr(0, bytes));
    const auto all = Sample({"all"});
    ASSERT_TRUE(all) << bytes << ": " << all.error().message;
    EXPECT_EQ(all->samples.carried, missing->samples.carried) << bytes;
    ASSERT_EQ(all->stats.left_out.size(), 1u);
    EXPECT_TRUE(all->stats.left_out[0].starts_with("texture: ")) << all->stats.left_out[0];
    EXPECT_NE(all->stats.left_out[0].find("uv.png"), std::string::npos) << all->stats.left_out[0];
    for (const Attributes& named : {Attributes{"texture"}, Attributes{"all", "texture"}}) {
      const auto refused = Sample(named);
      ASSERT_FALSE(refused) << bytes;
      EXPECT_EQ(refused.error().code, ErrorCode::kCorruptInput) << refused.error().message;
      EXPECT_NE(refused.error().message.find("uv.png"), std::string::npos);
    }
  }
}

TEST_F(ObjTexture, InQuotesIsTheFileOfThatNameOrTheOneTheyEnclose) {
  const auto expected = Sample({"texture"});
  ASSERT_TRUE(expected) << expected.error().message;
  std::filesystem::create_directory(folder_ / "in it");
  std::filesystem::rename(folder_ / "uv.png", folder_ / "in it/u v.png");
  const auto write_mtl = [&](const std::string& name) {
    std::string text = kMtl;
    for (std::size_t at = 0; (at = text.find("uv.png", at)) != std::string::npos;) {
      text.replace(at, 6, name);
      at += name.size();
    }
    test::WriteFile(folder_ / "m.mtl", text);
  };
  for (const char* const name : {"in it/u v.png", "in it\\u v.png", "\"in it/u v.png\"",
                                 "\"in it\\u v.png\"", "\"in it/u v.png\"  "}) {
    write_mtl(name);
    const auto found = Sample({"texture"});
    ASSERT_TRUE(found) << name << ": " << found.error().message;
    EXPECT_EQ(found->samples.carried, expected->samples.carried) << name;
  }
  // The file of that very name goes first.
  write_mtl("\"u v.png\"");
  test::WriteFile(folder_ / "u v.png", "no image");
  EXPECT_FALSE(Sample({"texture"}));
  test::WriteFile(folder_ / "\"u v.png\"", MakePng(UvPixels()));
  const auto literal = Sample({"texture"});
  ASSERT_TRUE(literal) << literal.error().message;
  EXPECT_EQ(literal->samples.carried, expected->samples.carried);
  for (const char* const name : {"\"none.png\"", "\"", "\"\"", "a\"u v.png\"", "\"u\" v.png\""}) {
    write_mtl(name);
    const auto none = Sample({"texture"});
    ASSERT_FALSE(none) << name;
    EXPECT_EQ(none.error().code, ErrorCode::kNotFound) << none.error().message;
  }
}

TEST_F(ObjTexture, IsFoundBesideALibraryInQuotes) {
  const auto expected = Sample({"texture"});
  ASSERT_TRUE(expected) << expected.error().message;
  std::filesystem::create_directory(folder_ / "in it");
  for (const char* const name : {"m.mtl", "uv.png"}) {
    std::filesystem::rename(folder_ / name, folder_ / ("in it/" + std::string(name)));
  }
  std::string obj = kObj;
  obj.replace(obj.find("m.mtl"), 5, "\"in it/m.mtl\"");
  test::WriteFile(folder_ / "m.obj", obj);
  const auto found = Sample({"texture"});
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(found->samples.carried, expected->samples.carried);
}

TEST_F(ObjTexture, WhoseLibraryIsMissingSaysSo) {
  std::filesystem::remove(folder_ / "m.mtl");
  const auto named = Sample({"texture"});
  ASSERT_FALSE(named);
  EXPECT_EQ(named.error().code, ErrorCode::kNotFound);
  EXPECT_NE(named.error().message.find("m.mtl"), std::string::npos) << named.error().message;
  EXPECT_TRUE(Sample({"all"}));
}

TEST_F(ObjTexture, OfAMeshWithoutAFolderSaysThatThereIsNone) {
  const auto named = Sampled(kObj, {"texture"});
  ASSERT_FALSE(named);
  EXPECT_EQ(named.error().code, ErrorCode::kUnsupported);
  EXPECT_NE(named.error().message.find("this input has no folder"), std::string::npos)
      << named.error().message;
}

TEST_F(ObjTexture, IsNeverLookedForOutsideTheFolder) {
  for (const char* const path : {"/etc/passwd", "../uv.png", "C:\\uv.png", "in/../../uv.png",
                                 "\"/etc/passwd\"", "\"../uv.png\"", "\"C:\\uv.png\""}) {
    test::WriteFile(folder_ / "m.mtl", "newmtl paint\nmap_Kd " + std::string(path) + "\n");
    const auto named = Sample({"texture"});
    ASSERT_FALSE(named) << path;
    EXPECT_EQ(named.error().code, ErrorCode::kUnsupported) << named.error().message;
  }
}

TEST_F(ObjTexture, IsListedWithSizeTypeAndMaterials) {
  const auto reader = OpenMesh(folder_ / "m.obj");
  ASSERT_TRUE(reader);
  RunContext context;
  const auto textures = (*reader)->InspectTextures(context);
  ASSERT_EQ(textures.size(), 1u);
  EXPECT_EQ(textures[0].place, "uv.png");
  EXPECT_EQ(textures[0].type, "png");
  EXPECT_EQ(textures[0].width, 256u);
  EXPECT_EQ(textures[0].height, 256u);
  EXPECT_EQ(textures[0].materials, (std::vector<std::uint32_t>{0, 1}));
  EXPECT_EQ(textures[0].fault, "");
}

// --- Memory and threads --------------------------------------------------------------------------

// A grid of squares whose materials take turns, each with an image of one colour, 256 KiB decoded.
class ManyTextures : public testing::Test {
 protected:
  static constexpr int kImages = 12;

  ManyTextures() {
    std::string obj = "mtllib m.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n", mtl;
    for (int k = 0; k < 60; ++k) {
      const std::string x = std::to_string(k), next = std::to_string(k + 1);
      obj += "v " + x + " 0 0\nv " + next + " 0 0\nv " + next + " 5 0\nv " + x + " 5 0\n";
      obj += "usemtl m" + std::to_string(k % kImages) + "\nf -4/1 -3/2 -2/3 -1/4\n";
    }
    for (int k = 0; k < kImages; ++k) {
      const std::string name = std::to_string(k);
      mtl += "newmtl m" + name + "\nmap_Kd " + name + ".png\n";
      test::WriteFile(folder_ / (name + ".png"),
                      MakePng(MakePixels(256, 256, 3, [&](unsigned, unsigned y, int c) {
                        return c == 0 ? static_cast<unsigned>(k) * 20 : c == 1 ? y : 7u;
                      })));
    }
    test::WriteFile(folder_ / "m.mtl", mtl);
    test::WriteFile(folder_ / "m.obj", obj);
  }

  Result<SampleResult> Sample(int threads, std::uint64_t memory) {
    auto reader = OpenMesh(folder_ / "m.obj");
    if (!reader) return Forward(reader);
    return Sampled(**reader, {"texture", "material"}, threads, memory);
  }

  test::TempFolder folder_;
};

TEST_F(ManyTextures, GiveTheSameBytesInAnyMemoryAndOnAnyThreads) {
  const auto whole = Sample(1, MemoryAccount::kUnlimited);
  ASSERT_TRUE(whole) << whole.error().message;
  for (std::size_t i = 0; i < whole->samples.size(); ++i) {
    const int square = static_cast<int>(std::floor(whole->samples.position[i].x));
    EXPECT_EQ(ColorOf(*whole, i)[0], square % kImages * 20);
  }
  for (const int threads : {1, 2}) {
    // Room for one or two images beside what sampling takes.
    for (const std::uint64_t mega : {64, 40}) {
      const auto part = Sample(threads, mega << 20);
      ASSERT_TRUE(part) << mega << " MiB: " << part.error().message;
      EXPECT_EQ(part->samples.carried, whole->samples.carried) << threads << ", " << mega << " MiB";
    }
  }
}

TEST_F(ManyTextures, OfWhichOneIsDamagedAreLeftOutByAllInAnyMemoryAndOnAnyThreads) {
  const std::string seven = MakePng(MakePixels(256, 256, 3, [](unsigned, unsigned, int) {  //
    return 140u;
  }));
  test::WriteFile(folder_ / "7.png", seven.substr(0, seven.size() - 30));
  std::optional<SampleResult> first;
  for (const int threads : {1, 2}) {
    for (const std::uint64_t memory : {MemoryAccount::kUnlimited, std::uint64_t{40} << 20}) {
      auto reader = OpenMesh(folder_ / "m.obj");
      ASSERT_TRUE(reader) << reader.error().message;
      auto all = Sampled(**reader, {"all"}, threads, memory);
      ASSERT_TRUE(all) << all.error().message;
      ASSERT_EQ(all->stats.left_out.size(), 1u);
      EXPECT_NE(all->stats.left_out[0].find("7.png"), std::string::npos);
      if (!first) first = *all;
      EXPECT_EQ(all->samples.carried, first->samples.carried) << threads << ", " << memory;
      EXPECT_EQ(all->stats.left_out, first->stats.left_out);
    }
  }
}

// The cache on its own, in a budget that holds one image and the work on it.
TEST_F(ManyTextures, AreDecodedAgainWhereMemoryHoldsOneAlone) {
  class Images : public TextureImages {
   public:
    std::string NameOf(std::uint32_t image) const override { return std::to_string(image); }
    Result<ImageFile> Read(std::uint32_t image, std::uint64_t most, MemoryAccount*) override {
      if (most > 1 << 20) ++reads;
      const std::string bytes =
          MakePng(MakePixels(256, 256, 3, [&](unsigned, unsigned, int) { return image * 20; }));
      return ImageFile{bytes.substr(0, most), bytes.size(), {}};
    }
    int reads = 0;
  } images;
  std::vector<BaseColor> materials(3);
  for (std::uint32_t k = 0; k < 3; ++k) materials[k].image = k;
  for (const std::uint64_t kilo : {1400, 1700, 4000}) {
    RunContext context(kilo << 10);
    BaseColorLookup lookup(images, materials, 3, context);
    images.reads = 0;
    std::array<unsigned char, 27> out{};
    for (std::size_t k = 0; k < 9; ++k) {
      auto added = lookup.Add(static_cast<std::uint32_t>(k % 3), 0.5, 0.5,
                              reinterpret_cast<char*>(out.data()) + 3 * k);
      ASSERT_TRUE(added);
      if (k == 5) {
        const auto flushed = lookup.Flush();
        ASSERT_TRUE(flushed) << flushed.error().message;
      }
    }
    const auto flushed = lookup.Flush();
    ASSERT_TRUE(flushed) << kilo << ": " << flushed.error().message;
    for (std::size_t k = 0; k < 9; ++k) EXPECT_EQ(out[3 * k], k % 3 * 20);
    if (kilo == 4000) {
      EXPECT_EQ(images.reads, 3);
    }
    if (kilo == 1400) {
      EXPECT_GT(images.reads, 3);
    }
    EXPECT_LE(context.memory().taken(), context.memory().budget());
  }
}

TEST(Texture, BeyondTheBudgetIsAnErrorBeforeAnyWork) {
  const auto large = MakePixels(3000, 3000, 1, [](unsigned, unsigned, int) { return 5u; });
  const auto reader = OpenMesh(MemorySource(Square(MakePng(large)).Glb()));
  ASSERT_TRUE(reader) << reader.error().message;
  const auto result = Sampled(**reader, {"all"}, 1, std::uint64_t{32} << 20);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(result.error().message.find("/images/0: the 3000 x 3000 pixels"), std::string::npos)
      << result.error().message;
}

}  // namespace
}  // namespace strata::io
