#include "io/image.h"

#include <algorithm>
#include <new>
#include <string_view>
#include <utility>

#include "io/image_decoders.h"
#include "io/quote.h"

namespace strata::io {
namespace {

constexpr std::uint64_t kMega = std::uint64_t{1} << 20;

std::optional<ImageType> TypeOf(std::string_view front) {
  using namespace std::string_view_literals;
  if (front.starts_with("\x89PNG\r\n\x1a\n"sv)) return ImageType::kPng;
  if (front.starts_with("\xff\xd8\xff"sv)) return ImageType::kJpeg;
  if (front.starts_with("RIFF"sv) && front.size() >= 12 && front.substr(8, 4) == "WEBP"sv) {
    return ImageType::kWebp;
  }
  return std::nullopt;
}

std::string SizeText(const ImageHead& head) {
  return std::to_string(head.width) + " x " + std::to_string(head.height) + " pixels";
}

// Deflate makes at most 1032 bytes of one. 8 x 8 pixels of a JPEG take a bit or more; with
// arithmetic coding somewhat less.
bool CanHold(const ImageHead& head, std::uint64_t size) {
  const std::uint64_t pixels = std::uint64_t{head.width} * head.height;
  switch (head.type) {
    case ImageType::kPng:
      return pixels / 8 * static_cast<std::uint64_t>(head.bits) / 1032 <= size;
    case ImageType::kJpeg:
      return pixels / 512 / 8 <= size;
    default:
      return true;  // An image of one colour takes some bytes, whatever its size.
  }
}

Result<std::optional<ImageHead>> HeadOf(std::span<const char> front) {
  const std::string_view text(front.data(), front.size());
  const auto type = TypeOf(text);
  if (!type) {
    return Fail(ErrorCode::kUnsupported, front.empty()
                                             ? "is empty, expected a PNG, JPEG or WebP image"
                                             : "begins with " + Quoted(text.substr(0, 12)) +
                                                   ", expected a PNG, JPEG or WebP image");
  }
  switch (*type) {
    case ImageType::kPng:
      return ReadPngHead(front);
    case ImageType::kJpeg:
      return ReadJpegHead(front);
    default:
      return ReadWebpHead(front);
  }
}

Result<void> DecodeTo(unsigned char* pixels, std::span<const char> bytes, const ImageHead& head,
                      const RunContext* context) {
  switch (head.type) {
    case ImageType::kPng:
      return DecodePng(bytes, head, pixels, context);
    case ImageType::kJpeg:
      return DecodeJpeg(bytes, head, pixels, context);
    default:
      return DecodeWebp(bytes, head, pixels);
  }
}

}  // namespace

const char* NameOf(ImageType type) {
  constexpr const char* kNames[] = {"png", "jpeg", "webp"};
  return kNames[static_cast<std::size_t>(type)];
}

std::uint64_t ImageHead::working_bytes() const {
  const std::uint64_t pixels = std::uint64_t{width} * height;
  switch (type) {
    case ImageType::kPng:
      return kMega + std::uint64_t{width} * 16;
    case ImageType::kJpeg:
      // Coefficients of 16 bits of up to four components, in whole blocks.
      return kMega + std::uint64_t{width} * 512 +
             (several_scans ? (pixels + (std::uint64_t{width} + height + 64) * 64) * 8 : 0);
    default:
      // Lossless: the image once more, as words.
      return kMega + pixels * 4 + std::uint64_t{width} * 256;
  }
}

Result<std::optional<ImageHead>> ReadImageHead(std::span<const char> front, std::uint64_t size,
                                               const std::string& who) {
  auto head = HeadOf(front);
  if (!head) return Fail(head.error().code, who + ": " + head.error().message);
  if (!*head) {
    if (front.size() < size) return head;
    return Fail(ErrorCode::kCorruptInput, who + ": the image ends within its head");
  }
  if ((*head)->width > kMostPixels || (*head)->height > kMostPixels) {
    return Fail(ErrorCode::kOverBudget, who + ": an image of " + SizeText(**head) +
                                            "; a side may have " + std::to_string(kMostPixels));
  }
  if (!CanHold(**head, size)) {
    return Fail(ErrorCode::kCorruptInput, who + ": found " + std::to_string(size) +
                                              " bytes, which cannot hold the " + SizeText(**head) +
                                              " that the image claims");
  }
  return head;
}

Result<Image> DecodeImage(std::span<const char> bytes, const std::string& who,
                          MemoryAccount* memory, const RunContext* context) try {
  auto head = ReadImageHead(bytes, bytes.size(), who);
  if (!head) return Forward(head);
  Image image;
  image.head_ = **head;
  MemoryShare working;
  if (memory != nullptr) {
    const std::string what = who + ": the " + SizeText(image.head_) + " of the image";
    auto share = memory->Take(image.head_.pixel_bytes(), what);
    if (!share) return Forward(share);
    image.share_ = std::move(*share);
    auto more = memory->Take(image.head_.working_bytes(), what + ", while it is decoded");
    if (!more) return Forward(more);
    working = std::move(*more);
  }
  // Not cleared: what is never written never takes memory.
  image.pixels_.reset(new unsigned char[static_cast<std::size_t>(image.head_.pixel_bytes())]);
  auto decoded = DecodeTo(image.pixels_.get(), bytes, image.head_, context);
  if (decoded) return image;
  if (decoded.error().code == ErrorCode::kCancelled) return Forward(decoded);
  return Fail(decoded.error().code, who + ": " + decoded.error().message);
} catch (const std::bad_alloc&) {
  return Fail(ErrorCode::kOverBudget, who + ": out of memory for the image");
}

}  // namespace strata::io
