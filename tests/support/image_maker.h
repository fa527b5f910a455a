// Images made by the libraries that everybody makes them with.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
//
#include <jpeglib.h>
#include <png.h>
#include <webp/encode.h>

#include <cstdlib>
#include <functional>
#include <string>
#include <vector>

namespace strata::test {

/// Pixels row by row from the top left, `channels` numbers of 8 or 16 bits each.
struct Pixels {
  std::uint32_t width = 0, height = 0;
  int channels = 3, bits = 8;
  std::vector<std::uint16_t> values{};
};

/// `value(x, y, channel)` for every pixel.
inline Pixels MakePixels(std::uint32_t width, std::uint32_t height, int channels,
                         const std::function<unsigned(unsigned, unsigned, int)>& value,
                         int bits = 8) {
  Pixels pixels{width, height, channels, bits, {}};
  for (unsigned y = 0; y < height; ++y) {
    for (unsigned x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c) {
        pixels.values.push_back(static_cast<std::uint16_t>(value(x, y, c)));
      }
    }
  }
  return pixels;
}

/// Red rises with u, green with v; as encoded, by one from column to column and row to row.
inline Pixels UvPixels() {
  return MakePixels(256, 256, 3, [](unsigned x, unsigned y, int c) {
    return c == 0 ? x : c == 1 ? y : 0u;
  });
}

/// The numbers of a row, as bytes, big endian.
inline std::vector<unsigned char> RowBytes(const Pixels& pixels, std::uint32_t y) {
  std::vector<unsigned char> row;
  const std::size_t n = std::size_t{pixels.width} * static_cast<std::size_t>(pixels.channels);
  for (std::size_t k = 0; k < n; ++k) {
    const unsigned value = pixels.values[y * n + k];
    if (pixels.bits == 16) row.push_back(static_cast<unsigned char>(value >> 8));
    row.push_back(static_cast<unsigned char>(value));
  }
  return row;
}

struct PngShape {
  bool interlaced = false;
  /// If not empty: the channel is an index of these colours, red, green, blue and alpha.
  std::vector<std::uint8_t> palette{};
};

inline std::string MakePng(const Pixels& pixels, const PngShape& shape = {}) {
  std::string out;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_set_write_fn(
      png, &out,
      [](png_structp p, png_bytep bytes, std::size_t n) {
        static_cast<std::string*>(png_get_io_ptr(p))->append(reinterpret_cast<char*>(bytes), n);
      },
      nullptr);
  constexpr int kTypes[] = {0, PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA, PNG_COLOR_TYPE_RGB,
                            PNG_COLOR_TYPE_RGB_ALPHA};
  const int type = shape.palette.empty() ? kTypes[pixels.channels] : PNG_COLOR_TYPE_PALETTE;
  png_set_IHDR(png, info, pixels.width, pixels.height, pixels.bits, type,
               shape.interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  std::vector<png_color> colors;
  std::vector<png_byte> alphas;
  for (std::size_t k = 0; k + 3 < shape.palette.size(); k += 4) {
    colors.push_back({shape.palette[k], shape.palette[k + 1], shape.palette[k + 2]});
    alphas.push_back(shape.palette[k + 3]);
  }
  if (!colors.empty()) {
    png_set_PLTE(png, info, colors.data(), static_cast<int>(colors.size()));
    png_set_tRNS(png, info, alphas.data(), static_cast<int>(alphas.size()), nullptr);
  }
  std::vector<std::vector<unsigned char>> rows;
  std::vector<png_bytep> pointers;
  for (std::uint32_t y = 0; y < pixels.height; ++y) rows.push_back(RowBytes(pixels, y));
  for (auto& row : rows) pointers.push_back(row.data());
  png_write_info(png, info);
  png_write_image(png, pointers.data());
  png_write_end(png, nullptr);
  png_destroy_write_struct(&png, &info);
  return out;
}

struct JpegShape {
  bool progressive = false;
  int quality = 100;
  bool subsampled = false;  ///< Colours at half the width and height.
  bool adobe = true;        ///< Of four channels: inks are stored as complements, and it says so.
};

/// One channel is grey, three are RGB, four inks.
inline std::string MakeJpeg(const Pixels& pixels, const JpegShape& shape = {}) {
  jpeg_compress_struct jpeg;
  jpeg_error_mgr errors;
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&jpeg, &bytes, &size);
  jpeg.image_width = pixels.width;
  jpeg.image_height = pixels.height;
  jpeg.input_components = pixels.channels;
  jpeg.in_color_space = pixels.channels == 1   ? JCS_GRAYSCALE
                        : pixels.channels == 3 ? JCS_RGB
                                               : JCS_CMYK;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, shape.quality, TRUE);
  if (shape.progressive) jpeg_simple_progression(&jpeg);
  const int factor = shape.subsampled ? 2 : 1;
  jpeg.comp_info[0].h_samp_factor = jpeg.comp_info[0].v_samp_factor = factor;
  if (pixels.channels == 4) jpeg.write_Adobe_marker = shape.adobe ? TRUE : FALSE;
  jpeg_start_compress(&jpeg, TRUE);
  for (std::uint32_t y = 0; y < pixels.height; ++y) {
    std::vector<unsigned char> row = RowBytes(pixels, y);
    unsigned char* rows[] = {row.data()};
    jpeg_write_scanlines(&jpeg, rows, 1);
  }
  jpeg_finish_compress(&jpeg);
  std::string out(reinterpret_cast<char*>(bytes), size);
  jpeg_destroy_compress(&jpeg);
  std::free(bytes);
  return out;
}

/// Of three or four channels.
inline std::string MakeWebp(const Pixels& pixels, bool lossless = true) {
  std::vector<unsigned char> all;
  for (std::uint32_t y = 0; y < pixels.height; ++y) {
    const std::vector<unsigned char> row = RowBytes(pixels, y);
    all.insert(all.end(), row.begin(), row.end());
  }
  const int w = static_cast<int>(pixels.width), h = static_cast<int>(pixels.height);
  const int stride = w * pixels.channels;
  unsigned char* bytes = nullptr;
  std::size_t size = 0;
  if (pixels.channels == 4) {
    size = lossless ? WebPEncodeLosslessRGBA(all.data(), w, h, stride, &bytes)
                    : WebPEncodeRGBA(all.data(), w, h, stride, 100, &bytes);
  } else {
    size = lossless ? WebPEncodeLosslessRGB(all.data(), w, h, stride, &bytes)
                    : WebPEncodeRGB(all.data(), w, h, stride, 100, &bytes);
  }
  std::string out(reinterpret_cast<char*>(bytes), size);
  WebPFree(bytes);
  return out;
}

}  // namespace strata::test
