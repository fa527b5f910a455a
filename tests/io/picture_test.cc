#include "io/picture.h"

#include <gtest/gtest.h>
#include <png.h>

#include <cmath>

#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::MessageOf;
using test::ReadFile;
using test::TempFolder;

// Samples evenly over the unit sphere around `centre`.
SampleColumns Ball(std::size_t n, Vec3 centre = {}, double radius = 1) {
  SampleColumns s;
  for (std::size_t i = 0; i < n; ++i) {
    const double z = 1 - (2 * static_cast<double>(i) + 1) / static_cast<double>(n);
    const double angle = static_cast<double>(i) * 2.399963229728653;
    const double across = std::sqrt(1 - z * z);
    const Vec3 d{across * std::cos(angle), across * std::sin(angle), z};
    s.position.push_back(centre + d * radius);
    s.normal.push_back({static_cast<float>(d.x), static_cast<float>(d.y), static_cast<float>(d.z)});
  }
  return s;
}

struct Image {
  int width = 0, height = 0;
  std::vector<unsigned char> pixels;
  const unsigned char* at(int x, int y) const {
    return &pixels[3 * static_cast<std::size_t>(y * width + x)];
  }
  // The background is as pale as its left edge in the same row.
  bool IsDrawn(int x, int y) const {
    const unsigned char *p = at(x, y), *edge = at(0, y);
    return std::abs(p[0] - edge[0]) + std::abs(p[1] - edge[1]) + std::abs(p[2] - edge[2]) > 12;
  }
  Bounds DrawnBox() const {
    Bounds box;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        if (IsDrawn(x, y)) box.Add({double(x), double(y), 0});
      }
    }
    return box;
  }
};

Image Load(const std::string& path) {
  Image image;
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_file(&png, path.c_str()) == 0) {
    ADD_FAILURE() << png.message;
    return image;
  }
  png.format = PNG_FORMAT_RGB;
  image.pixels.resize(PNG_IMAGE_SIZE(png));
  EXPECT_NE(png_image_finish_read(&png, nullptr, image.pixels.data(), 0, nullptr), 0);
  image.width = static_cast<int>(png.width);
  image.height = static_cast<int>(png.height);
  return image;
}

Image Draw(const SampleColumns& samples, const PictureOptions& options) {
  TempFolder folder;
  const auto written = WritePicture(folder / "a.png", samples, options);
  if (!written) {
    ADD_FAILURE() << MessageOf(written);
    return {};
  }
  EXPECT_EQ(folder.List(), std::vector<std::string>{"a.png"});
  return Load(folder / "a.png");
}

TEST(Picture, FillsTheFrameWhateverTheSizeAndPlaceOfTheModel) {
  for (const double size : {1e-20, 1.0, 1e30}) {
    for (const Vec3 centre : {Vec3{}, Vec3{1e6, -1e6, 1e6}}) {
      SCOPED_TRACE(size);
      const Image image =
          Draw(Ball(3000, centre * size, size), {.edge = 0.06 * size, .width = 320, .height = 240});
      ASSERT_EQ(image.width, 320);
      ASSERT_EQ(image.height, 240);
      const Bounds box = image.DrawnBox();
      EXPECT_NEAR(box.max.y - box.min.y, 240 * 0.88, 6);
      EXPECT_NEAR((box.min.y + box.max.y) / 2, 120, 4);
      EXPECT_NEAR((box.min.x + box.max.x) / 2, 160, 4);
    }
  }
}

TEST(Picture, ShowsSeparateDiscsAndNoHoles) {
  const Image image = Draw(Ball(3000), {.edge = 0.06, .width = 640, .height = 480});
  int blue = 0, pale = 0, undrawn = 0, all = 0;
  for (int y = 200; y < 280; ++y) {
    for (int x = 280; x < 360; ++x, ++all) {
      const unsigned char* p = image.at(x, y);
      blue += p[2] > p[0] + 60;
      pale += std::abs(p[2] - p[0]) < 40;
      undrawn += !image.IsDrawn(x, y) && std::abs(p[2] - p[0]) > 20;
    }
  }
  EXPECT_GT(blue, all / 10);
  EXPECT_GT(pale, all / 10);
  EXPECT_EQ(undrawn, 0);
}

TEST(Picture, IsTheSameTwice) {
  TempFolder folder;
  const SampleColumns samples = Ball(500);
  for (const char* name : {"a", "b"}) {
    ASSERT_TRUE(WritePicture(folder / name, samples, {.edge = 0.1}));
  }
  EXPECT_TRUE(ReadFile(folder / "a") == ReadFile(folder / "b"));
}

TEST(Picture, DrawsWithoutNormalsAndWithUselessOnes) {
  SampleColumns samples = Ball(3000);
  samples.normal.clear();
  const Image bare = Draw(samples, {.edge = 0.06, .width = 320, .height = 240});
  EXPECT_GT(bare.DrawnBox().max.y, 200);
  samples.normal.assign(3000, Vec3f{0, 0, 0});
  samples.normal[1] = {NAN, 0, 0};
  Draw(samples, {.edge = 0.06, .width = 320, .height = 240});
}

TEST(Picture, DrawsOneSampleAndManyInOnePlace) {
  for (const std::size_t n : {1, 100}) {
    SampleColumns samples;
    samples.position.assign(n, Vec3{3, 4, 5});
    const Image image = Draw(samples, {.edge = 0.5, .width = 64, .height = 64});
    EXPECT_TRUE(image.IsDrawn(32, 32));
  }
}

TEST(Picture, EveryAxisCanPointUpAndEveryTurnShowsAnotherSide) {
  // A pillar along each axis: only the one that points up is seen from its long side, upright.
  for (int axis = 0; axis < 3; ++axis) {
    SampleColumns pillar = Ball(2000);
    pillar.normal.clear();
    for (Vec3& p : pillar.position) p[axis] *= 5;
    const Bounds box =
        Draw(pillar, {.edge = 0.1, .width = 256, .height = 256, .up_axis = axis}).DrawnBox();
    EXPECT_GT(box.max.y - box.min.y, 2 * (box.max.x - box.min.x)) << "axis " << axis;
  }
  SampleColumns lopsided = Ball(500);
  lopsided.position.push_back({4, 0, 1});
  lopsided.normal.push_back({1, 0, 0});
  std::vector<std::vector<unsigned char>> seen;
  for (int turns = 0; turns < 4; ++turns) {
    const Image image =
        Draw(lopsided, {.edge = 0.1, .width = 128, .height = 96, .quarter_turns = turns});
    for (const auto& other : seen) EXPECT_TRUE(other != image.pixels) << turns << " turns";
    seen.push_back(image.pixels);
  }
}

TEST(Picture, RefusesOptionsOutOfRange) {
  const SampleColumns samples = Ball(10);
  const PictureOptions bad[] = {{.edge = 0},     {.edge = -1},        {.edge = NAN},
                                {.width = 15},   {.height = 4097},    {.up_axis = 3},
                                {.up_axis = -1}, {.quarter_turns = 4}};
  for (const PictureOptions& options : bad) {
    const auto refused = WritePicture("/dev/null", samples, options);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
  }
}

TEST(Picture, RefusesNoSamplesAndPositionsThatAreNotFinite) {
  const auto none = WritePicture("/dev/null", {}, {});
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kEmptySurface);
  for (const double bad : {HUGE_VAL, -HUGE_VAL, std::nan("")}) {
    for (int axis = 0; axis < 3; ++axis) {
      SampleColumns samples = Ball(10);
      samples.position[3][axis] = bad;
      const auto refused = WritePicture("/dev/null", samples, {});
      ASSERT_FALSE(refused) << bad << " on axis " << axis;
      EXPECT_EQ(refused.error().code, ErrorCode::kInternal);
    }
  }
}

TEST(Picture, AFullDiskIsAnError) {
  const auto refused = WritePicture("/dev/full", Ball(10), {});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
}

}  // namespace
}  // namespace strata::io
