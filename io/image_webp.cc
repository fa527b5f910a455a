#include <webp/decode.h>

#include <cstdint>
#include <string>

#include "io/image_decoders.h"

namespace strata::io {
namespace {

const std::uint8_t* Bytes(std::span<const char> bytes) {
  return reinterpret_cast<const std::uint8_t*>(bytes.data());
}

tl::unexpected<Error> Failure(VP8StatusCode status) {
  switch (status) {
    case VP8_STATUS_OUT_OF_MEMORY:
      return Fail(ErrorCode::kOverBudget, "out of memory for libwebp");
    case VP8_STATUS_UNSUPPORTED_FEATURE:
      return Fail(ErrorCode::kUnsupported, "WebP: a feature that is not read");
    case VP8_STATUS_NOT_ENOUGH_DATA:
    case VP8_STATUS_SUSPENDED:
      return Fail(ErrorCode::kCorruptInput, "WebP: the image ends too early");
    default:
      return Fail(ErrorCode::kCorruptInput, "WebP: the image is damaged");
  }
}

// What the container says of its own size, the eight bytes before that included.
std::uint64_t ContainerBytes(std::span<const char> bytes) {
  std::uint64_t size = 8;
  for (std::size_t k = 0; k < 4; ++k) {
    size += std::uint64_t{static_cast<std::uint8_t>(bytes[4 + k])} << (8 * k);
  }
  return size;
}

}  // namespace

Result<std::optional<ImageHead>> ReadWebpHead(std::span<const char> front) {
  WebPBitstreamFeatures features;
  const VP8StatusCode status = WebPGetFeatures(Bytes(front), front.size(), &features);
  if (status == VP8_STATUS_NOT_ENOUGH_DATA) return std::optional<ImageHead>();
  if (status != VP8_STATUS_OK) return Failure(status);
  if (features.has_animation != 0) {
    return Fail(ErrorCode::kUnsupported, "WebP: an animation, expected one image");
  }
  if (features.width < 1 || features.height < 1) return Failure(VP8_STATUS_BITSTREAM_ERROR);
  ImageHead head;
  head.type = ImageType::kWebp;
  head.width = static_cast<std::uint32_t>(features.width);
  head.height = static_cast<std::uint32_t>(features.height);
  head.channels = features.has_alpha != 0 ? 4 : 3;
  return std::optional(head);
}

Result<void> DecodeWebp(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels) {
  if (ContainerBytes(bytes) > bytes.size()) return Failure(VP8_STATUS_NOT_ENOUGH_DATA);
  WebPDecoderConfig config;
  if (WebPInitDecoderConfig(&config) == 0) {
    return Fail(ErrorCode::kInternal, "libwebp is of another version than its headers");
  }
  config.output.colorspace = MODE_RGBA;
  config.output.is_external_memory = 1;
  config.output.u.RGBA.rgba = pixels;
  config.output.u.RGBA.stride = static_cast<int>(head.width) * 4;
  config.output.u.RGBA.size = static_cast<std::size_t>(head.pixel_bytes());
  const VP8StatusCode status = WebPDecode(Bytes(bytes), bytes.size(), &config);
  WebPFreeDecBuffer(&config.output);
  return status == VP8_STATUS_OK ? Result<void>() : Result<void>(Failure(status));
}

}  // namespace strata::io
