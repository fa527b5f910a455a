// Images that are textures: PNG, JPEG and WebP.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "core/memory_account.h"
#include "core/result.h"
#include "core/run_context.h"

namespace strata::io {

enum class ImageType : std::uint8_t { kPng, kJpeg, kWebp };
/// "png", "jpeg", "webp".
const char* NameOf(ImageType type);

/// What an image says of itself.
struct ImageHead {
  ImageType type = ImageType::kPng;
  std::uint32_t width = 0, height = 0;  ///< Pixels, 1 to kMostPixels each.
  int channels = 3;                     ///< Of the file's pixels: 1 to 4. A palette is 3 or 4.
  int bits = 8;                         ///< Of a channel in the file: 1 to 16.
  bool several_scans = false;           ///< JPEG: all of it is in memory before any pixel is.

  /// Of a pixel once it is decoded: 1 or 2.
  std::size_t channel_bytes() const { return bits > 8 ? 2 : 1; }
  /// Of the decoded image; at most 2^35.
  std::uint64_t pixel_bytes() const { return std::uint64_t{width} * height * 4 * channel_bytes(); }
  /// What decoding takes beside it, at most.
  std::uint64_t working_bytes() const;
};
inline constexpr std::uint32_t kMostPixels = 65535;  ///< Of a side.

/// Pixels from the top left, row by row: red, green, blue and alpha, encoded as they were (sRGB by
/// assumption: gamma and profiles in the file are ignored, as glTF demands). Grey is three equal
/// channels, CMYK was turned into RGB, alpha is opaque where the file has none and never multiplied
/// in.
class Image {
 public:
  std::uint32_t width() const { return head_.width; }
  std::uint32_t height() const { return head_.height; }
  const ImageHead& head() const { return head_; }
  /// The first channel of a pixel. The four are 8 bits, or 16 in the machine's byte order.
  const unsigned char* At(std::uint32_t x, std::uint32_t y) const {
    return pixels_.get() + (std::size_t{y} * head_.width + x) * 4 * head_.channel_bytes();
  }

 private:
  friend Result<Image> DecodeImage(std::span<const char>, const std::string&, MemoryAccount*,
                                   const RunContext*);
  ImageHead head_;
  std::unique_ptr<unsigned char[]> pixels_;
  MemoryShare share_;
};

/// The head of an image of `size` bytes of which `front` is the beginning; none if that does not
/// tell yet (256 bytes do for PNG and WebP). The type is told by the bytes, whatever anybody says.
/// `who`, the image's name, stands in front of messages. Errors: kUnsupported (another type, an
/// animation); kCorruptInput (also: so few bytes that they cannot hold so many pixels); kOverBudget
/// (a side above kMostPixels).
Result<std::optional<ImageHead>> ReadImageHead(std::span<const char> front, std::uint64_t size,
                                               const std::string& who);

/// Decodes a whole image; all of its bytes must be there, to the end that its format marks. Memory:
/// pixel_bytes(), kept by the image, and working_bytes(), both taken from `memory` if given before
/// anything is allocated. `context`, if given, is polled for cancelling. Threads: any. Errors: as
/// above, kCancelled.
Result<Image> DecodeImage(std::span<const char> bytes, const std::string& who,
                          MemoryAccount* memory, const RunContext* context = nullptr);

}  // namespace strata::io
