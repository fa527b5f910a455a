#include "io/image.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <zlib.h>

#include <array>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "core/memory_account.h"
#include "tests/support/image_maker.h"

namespace strata::io {
namespace {

using test::JpegShape;
using test::MakeJpeg;
using test::MakePixels;
using test::MakePng;
using test::MakeWebp;
using test::Pixels;
using test::UvPixels;
using Four = std::array<int, 4>;

Image Decoded(const std::string& bytes) {
  auto image = DecodeImage(bytes, "image", nullptr);
  EXPECT_TRUE(image) << image.error().message;
  return image ? std::move(*image) : Image();
}

Four At(const Image& image, std::uint32_t x, std::uint32_t y) {
  const unsigned char* const p = image.At(x, y);
  if (image.head().channel_bytes() == 1) return {p[0], p[1], p[2], p[3]};
  std::uint16_t wide[4];
  std::memcpy(wide, p, sizeof wide);
  return {wide[0], wide[1], wide[2], wide[3]};
}

// The largest difference of a channel between the image and the pixels that it was made of.
int FurthestOf(const Image& image, const Pixels& pixels) {
  int furthest = 0;
  std::size_t k = 0;
  for (std::uint32_t y = 0; y < pixels.height; ++y) {
    for (std::uint32_t x = 0; x < pixels.width; ++x) {
      const Four found = At(image, x, y);
      for (std::size_t c = 0; c < static_cast<std::size_t>(pixels.channels); ++c) {
        furthest = std::max(furthest, std::abs(found[c] - pixels.values[k++]));
      }
    }
  }
  return furthest;
}

// 5 x 3 pixels of noise that is the same on every run.
Pixels Noise(int channels, int bits = 8, std::uint32_t width = 5, std::uint32_t height = 3) {
  unsigned state = 12345;
  return MakePixels(
      width, height, channels,
      [&](unsigned, unsigned, int) {
        state = state * 1103515245 + 12345;
        return state >> 16 & ((1u << bits) - 1);
      },
      bits);
}

TEST(Image, OfAPngIsExact) {
  for (const int bits : {8, 16}) {
    for (const bool interlaced : {false, true}) {
      for (const int channels : {3, 4}) {
        const Pixels pixels = Noise(channels, bits, 21, 13);
        const Image image = Decoded(MakePng(pixels, {interlaced, {}}));
        EXPECT_EQ(FurthestOf(image, pixels), 0) << bits << " bits, " << channels << " channels";
        EXPECT_EQ(image.head().bits, bits);
      }
    }
  }
}

TEST(Image, OfGreyIsThreeEqualChannels) {
  const Image grey =
      Decoded(MakePng(MakePixels(2, 1, 1, [](unsigned x, unsigned, int) { return x * 200; })));
  EXPECT_EQ(At(grey, 1, 0), (Four{200, 200, 200, 255}));
  const Image half = Decoded(
      MakePng(MakePixels(1, 1, 2, [](unsigned, unsigned, int c) { return c == 0 ? 77u : 128u; })));
  EXPECT_EQ(At(half, 0, 0), (Four{77, 77, 77, 128}));
  const Image jpeg =
      Decoded(MakeJpeg(MakePixels(9, 9, 1, [](unsigned, unsigned, int) { return 130u; })));
  EXPECT_EQ(At(jpeg, 8, 8), (Four{130, 130, 130, 255}));
}

TEST(Image, OfAPaletteHasItsColoursAndAlphas) {
  const Image image =
      Decoded(MakePng(MakePixels(2, 1, 1, [](unsigned x, unsigned, int) { return x; }),
                      {false, {1, 2, 3, 255, 200, 100, 50, 7}}));
  EXPECT_EQ(At(image, 0, 0), (Four{1, 2, 3, 255}));
  EXPECT_EQ(At(image, 1, 0), (Four{200, 100, 50, 7}));
}

TEST(Image, OfAWebpIsExactIfItIsLossless) {
  const Pixels opaque = Noise(3, 8, 21, 13);
  EXPECT_EQ(FurthestOf(Decoded(MakeWebp(opaque)), opaque), 0);
  // Colours below no alpha at all are the encoder's business.
  Pixels clear = Noise(4, 8, 21, 13);
  for (std::size_t k = 3; k < clear.values.size(); k += 4) clear.values[k] |= 1;
  EXPECT_EQ(FurthestOf(Decoded(MakeWebp(clear)), clear), 0);
  EXPECT_LE(FurthestOf(Decoded(MakeWebp(UvPixels(), false)), UvPixels()), 8);
}

TEST(Image, OfAJpegIsNearInEveryMode) {
  for (const bool progressive : {false, true}) {
    for (const bool subsampled : {false, true}) {
      JpegShape shape;
      shape.progressive = progressive;
      shape.subsampled = subsampled;
      const Image image = Decoded(MakeJpeg(UvPixels(), shape));
      EXPECT_EQ(image.head().several_scans, progressive);
      EXPECT_LE(FurthestOf(image, UvPixels()), 3) << progressive << subsampled;
    }
  }
}

TEST(Image, OfFourInksIsWhatTheyLookLike) {
  // Cyan and some black; Adobe's way stores complements.
  const auto inks = [](bool complements) {
    return MakePixels(8, 8, 4, [=](unsigned, unsigned, int c) {
      const unsigned ink = c == 0 ? 255u : c == 3 ? 55u : 0u;
      return complements ? 255 - ink : ink;
    });
  };
  for (const bool adobe : {true, false}) {
    JpegShape shape;
    shape.adobe = adobe;
    const Four found = At(Decoded(MakeJpeg(inks(adobe), shape)), 3, 3);
    const Four expected = {0, 200, 200, 255};
    for (std::size_t c = 0; c < 4; ++c) EXPECT_NEAR(found[c], expected[c], 2) << adobe << c;
  }
}

std::vector<std::string> OneOfEach() {
  JpegShape progressive;
  progressive.progressive = true;
  progressive.subsampled = true;
  return {MakePng(Noise(4, 16, 7, 5), {true, {}}),
          MakePng(Noise(3)),
          MakeJpeg(Noise(3, 8, 17, 9)),
          MakeJpeg(Noise(3, 8, 17, 9), progressive),
          MakeJpeg(Noise(4)),
          MakeWebp(Noise(4)),
          MakeWebp(Noise(3, 8, 17, 9), false),
          MakeWebp(Noise(4, 8, 17, 9), false)};
}

TEST(Image, IsRefusedWhereverItIsCut) {
  for (const std::string& bytes : OneOfEach()) {
    ASSERT_TRUE(DecodeImage(bytes, "image", nullptr));
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      // In memory of its own, so that a byte read too far is seen.
      const std::vector<char> prefix(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(n));
      const auto image = DecodeImage(prefix, "cut", nullptr);
      ASSERT_FALSE(image) << "at " << n << " of " << bytes.size();
      EXPECT_TRUE(image.error().message.starts_with("cut: ")) << image.error().message;
      EXPECT_TRUE(image.error().code == ErrorCode::kCorruptInput ||
                  image.error().code == ErrorCode::kUnsupported);
    }
  }
}

TEST(Image, IsReadOrRefusedWhateverByteIsDamaged) {
  int refused = 0;
  for (const std::string& bytes : OneOfEach()) {
    for (std::size_t n = 0; n < bytes.size(); ++n) {
      std::string damaged = bytes;
      damaged[n] = static_cast<char>(damaged[n] ^ (1 << (n % 8)));
      MemoryAccount memory(std::uint64_t{64} << 20);
      const auto image = DecodeImage(damaged, "damaged", &memory);
      if (image) continue;
      ++refused;
      EXPECT_NE(image.error().code, ErrorCode::kInternal) << image.error().message;
    }
  }
  EXPECT_GT(refused, 500);
}

TEST(Image, ThatExceedsTheBudgetSaysItsNameAndSize) {
  const Pixels large = MakePixels(1000, 500, 3, [](unsigned, unsigned, int) { return 1u; });
  for (const std::string& bytes : {MakePng(large), MakeJpeg(large), MakeWebp(large)}) {
    MemoryAccount memory(1 << 20);
    const auto image = DecodeImage(bytes, "model.obj: the image 'large'", &memory);
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().code, ErrorCode::kOverBudget);
    EXPECT_NE(image.error().message.find("'large': the 1000 x 500 pixels"), std::string::npos)
        << image.error().message;
    EXPECT_EQ(memory.taken(), 0u);
  }
}

TEST(Image, ThatClaimsMoreThanItsBytesCanHoldIsRefusedBeforeAnyIsTaken) {
  std::string png = MakePng(Noise(3));
  png.replace(16, 8, std::string("\0\0\xff\xff\0\0\xff\xff", 8));
  std::string jpeg = MakeJpeg(Noise(3));
  const std::size_t frame = jpeg.find("\xff\xc0");
  ASSERT_NE(frame, std::string::npos);
  jpeg.replace(frame + 5, 4, "\xff\x00\xff\x00", 4);
  for (const std::string& bytes : {png, jpeg}) {
    const auto image = DecodeImage(bytes, "bomb", nullptr);
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().code, ErrorCode::kCorruptInput);
    EXPECT_NE(image.error().message.find("cannot hold the"), std::string::npos)
        << image.error().message;
  }
}

std::string PngChunk(const std::string& type, const std::string& body) {
  const auto big_endian = [](unsigned long number) {
    std::string text;
    for (const int shift : {24, 16, 8, 0}) text += static_cast<char>(number >> shift & 255);
    return text;
  };
  const std::string all = type + body;
  const auto* const bytes = reinterpret_cast<const unsigned char*>(all.data());
  return big_endian(body.size()) + all +
         big_endian(crc32(0, bytes, static_cast<unsigned>(all.size())));
}

// Eight kilobytes a chunk, of which libpng would keep eight megabytes each.
TEST(Image, WithTextsThatUnpackToGigabytesTakesNoneOfThem) {
  const Pixels noise = Noise(3);
  const std::string text(7'900'000, 'a');
  std::vector<unsigned char> packed(compressBound(text.size()));
  unsigned long size = packed.size();
  ASSERT_EQ(compress2(packed.data(), &size, reinterpret_cast<const unsigned char*>(text.data()),
                      text.size(), 9),
            Z_OK);
  const std::string body =
      std::string("key\0\0", 5) + std::string(reinterpret_cast<const char*>(packed.data()), size);
  std::string texts;
  for (int k = 0; k < 100; ++k) texts += PngChunk("zTXt", body);
  constexpr std::size_t kHead = 33;  // Signature and IHDR.
  std::string png = MakePng(noise);
  png.insert(kHead, texts);
  rusage before{}, after{};
  ASSERT_EQ(getrusage(RUSAGE_SELF, &before), 0);
  const Image image = Decoded(png);
  ASSERT_EQ(getrusage(RUSAGE_SELF, &after), 0);
  EXPECT_EQ(FurthestOf(image, noise), 0);
  EXPECT_LT(after.ru_maxrss - before.ru_maxrss, 100'000) << "kilobytes; kept, they are 790,000";
}

TEST(Image, OfAPaletteWhoseAlphasAreDamagedIsRefusedNotOpaque) {
  std::string png = MakePng(MakePixels(2, 1, 1, [](unsigned x, unsigned, int) { return x; }),
                            {.palette = {255, 0, 0, 10, 0, 255, 0, 20}});
  const std::size_t alphas = png.find("tRNS");
  ASSERT_NE(alphas, std::string::npos);
  png[alphas + 4] = 11;
  const auto image = DecodeImage(png, "image", nullptr);
  ASSERT_FALSE(image);
  EXPECT_EQ(image.error().code, ErrorCode::kCorruptInput);
}

TEST(Image, IsToldByItsBytesAndOtherTypesAreRefused) {
  const auto gif = DecodeImage(std::string("GIF89a-and-more"), "x.png", nullptr);
  ASSERT_FALSE(gif);
  EXPECT_EQ(gif.error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(gif.error().message,
            "x.png: begins with 'GIF89a-and-m', expected a PNG, JPEG or WebP image");
  EXPECT_FALSE(DecodeImage(std::string(), "empty", nullptr));
}

TEST(ImageHead, IsKnownFromTheFront) {
  for (const std::string& bytes : OneOfEach()) {
    const auto whole = ReadImageHead(bytes, bytes.size(), "image");
    ASSERT_TRUE(whole && *whole);
    const auto start = std::span<const char>(bytes).first(12);
    const auto early = ReadImageHead(start, bytes.size(), "image");
    ASSERT_TRUE(early) << early.error().message;
    EXPECT_FALSE(*early) << "twelve bytes do not tell";
    const std::size_t most = std::min<std::size_t>(bytes.size(), 700);
    const auto head =
        ReadImageHead(std::span<const char>(bytes).first(most), bytes.size(), "image");
    ASSERT_TRUE(head && *head);
    EXPECT_EQ((*head)->width, (*whole)->width);
    EXPECT_EQ((*head)->type, (*whole)->type);
  }
}

}  // namespace
}  // namespace strata::io
