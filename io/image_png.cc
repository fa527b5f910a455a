#include <png.h>

#include <bit>
#include <csetjmp>
#include <cstring>
#include <string>
#include <string_view>

#include "io/image_decoders.h"

namespace strata::io {
namespace {

// All that a decoding has, in one place: libpng leaves by longjmp, over which no object with a
// destructor may live.
struct PngJob {
  const char* at = nullptr;
  std::size_t left = 0;
  const ImageHead* head = nullptr;
  unsigned char* pixels = nullptr;
  const RunContext* context = nullptr;
  bool cancelled = false;
  char message[160] = {};
  png_structp png = nullptr;
  png_infop info = nullptr;
};

[[noreturn]] void OnError(png_structp png, png_const_charp message) {
  auto* const job = static_cast<PngJob*>(png_get_error_ptr(png));
  std::strncpy(job->message, message, sizeof job->message - 1);
  png_longjmp(png, 1);
}

void OnWarning(png_structp, png_const_charp) {}

void Fill(png_structp png, png_bytep out, std::size_t n) {
  auto* const job = static_cast<PngJob*>(png_get_io_ptr(png));
  if (n > job->left) png_error(png, "the image ends too early");
  std::memcpy(out, job->at, n);
  job->at += n;
  job->left -= n;
}

// Everything as four channels of 8 or 16 bits; gamma and profiles are not applied.
void AskForRgba(const PngJob& job) {
  png_set_expand(job.png);
  png_set_gray_to_rgb(job.png);
  png_set_add_alpha(job.png, 0xffff, PNG_FILLER_AFTER);
  if (std::endian::native == std::endian::little) png_set_swap(job.png);
}

bool Run(PngJob& job) {
  if (setjmp(png_jmpbuf(job.png)) != 0) return false;  // NOLINT(cert-err52-cpp)
  png_set_read_fn(job.png, &job, Fill);
  png_set_user_limits(job.png, kMostPixels, kMostPixels);
  // Texts and profiles say nothing here, and libpng would keep megabytes for each kilobyte of them.
  png_set_keep_unknown_chunks(job.png, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
  // Else a damaged tRNS is dropped in silence, and with it all transparency.
  png_set_crc_action(job.png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
  png_read_info(job.png, job.info);
  AskForRgba(job);
  const int passes = png_set_interlace_handling(job.png);
  png_read_update_info(job.png, job.info);
  const std::size_t row = std::size_t{job.head->width} * 4 * job.head->channel_bytes();
  if (png_get_rowbytes(job.png, job.info) != row) png_error(job.png, "rows of another length");
  for (int pass = 0; pass < passes; ++pass) {
    for (std::uint32_t y = 0; y < job.head->height; ++y) {
      job.cancelled = y % 256 == 0 && job.context != nullptr && job.context->cancelled();
      if (job.cancelled) return false;
      png_read_row(job.png, job.pixels + y * row, nullptr);
    }
  }
  png_read_end(job.png, nullptr);
  return true;
}

std::uint32_t BigEndian(std::span<const char> bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t k = 0; k < 4; ++k) value = value << 8 | static_cast<std::uint8_t>(bytes[at + k]);
  return value;
}

int ChannelsOf(int color_type) {
  switch (color_type) {
    case PNG_COLOR_TYPE_GRAY:
      return 1;
    case PNG_COLOR_TYPE_GRAY_ALPHA:
      return 2;
    case PNG_COLOR_TYPE_RGB:
    case PNG_COLOR_TYPE_PALETTE:
      return 3;
    case PNG_COLOR_TYPE_RGB_ALPHA:
      return 4;
    default:
      return 0;
  }
}

}  // namespace

Result<std::optional<ImageHead>> ReadPngHead(std::span<const char> front) {
  constexpr std::size_t kHead = 26;
  if (front.size() < kHead) return std::optional<ImageHead>();
  ImageHead head;
  head.type = ImageType::kPng;
  head.width = BigEndian(front, 16);
  head.height = BigEndian(front, 20);
  head.bits = front[24];
  head.channels = ChannelsOf(front[25]);
  const bool sound = BigEndian(front, 8) == 13 &&
                     std::string_view(front.data() + 12, 4) == "IHDR" && head.width > 0 &&
                     head.height > 0 && head.channels > 0 && head.bits >= 1 && head.bits <= 16 &&
                     std::has_single_bit(static_cast<unsigned>(head.bits));
  if (!sound) return Fail(ErrorCode::kCorruptInput, "PNG: the head is damaged");
  return std::optional(head);
}

Result<void> DecodePng(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels,
                       const RunContext* context) {
  PngJob job;
  job.at = bytes.data();
  job.left = bytes.size();
  job.head = &head;
  job.pixels = pixels;
  job.context = context;
  job.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &job, OnError, OnWarning);
  if (job.png != nullptr) job.info = png_create_info_struct(job.png);
  const bool ready = job.info != nullptr;
  const bool done = ready && Run(job);
  png_destroy_read_struct(&job.png, &job.info, nullptr);
  if (done) return {};
  if (job.cancelled) return Cancelled();
  if (!ready) return Fail(ErrorCode::kOverBudget, "out of memory for libpng");
  return Fail(ErrorCode::kCorruptInput, std::string("PNG: ") + job.message);
}

}  // namespace strata::io
