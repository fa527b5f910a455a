// One decoder per image format; io/image.cc alone calls them.
#pragma once

#include <optional>
#include <span>
#include <string>

#include "core/result.h"
#include "core/run_context.h"
#include "io/image.h"

namespace strata::io {

/// Heads: none if the front does not tell. Of the sides only what the format itself bounds is
/// checked. Messages lack the image's name.
Result<std::optional<ImageHead>> ReadPngHead(std::span<const char> front);
Result<std::optional<ImageHead>> ReadJpegHead(std::span<const char> front);
Result<std::optional<ImageHead>> ReadWebpHead(std::span<const char> front);

/// Fills `pixels` (head.pixel_bytes() of them). `head` is what the bytes' own head said.
Result<void> DecodePng(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels,
                       const RunContext* context);
Result<void> DecodeJpeg(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels,
                        const RunContext* context);
Result<void> DecodeWebp(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels);

}  // namespace strata::io
