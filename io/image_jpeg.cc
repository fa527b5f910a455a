// jpeglib.h wants these before it.
#include <cstddef>
#include <cstdio>
//
#include <jerror.h>
#include <jpeglib.h>

#include <csetjmp>
#include <string>

#include "io/image_decoders.h"

namespace strata::io {
namespace {

// More scans than that are no image: each goes over all pixels again.
constexpr int kMostScans = 200;

// All that a decoding has, in one place: libjpeg leaves by longjmp, over which no object with a
// destructor may live.
struct JpegJob {
  jpeg_decompress_struct jpeg;
  jpeg_error_mgr errors;
  jpeg_progress_mgr progress;
  std::jmp_buf leave;
  char message[JMSG_LENGTH_MAX];
  bool ended, cancelled;  // The bytes did; the caller asked to.
  const RunContext* context;
  const ImageHead* head;
  unsigned char* pixels;
};

JpegJob& JobOf(j_common_ptr jpeg) { return *static_cast<JpegJob*>(jpeg->client_data); }

[[noreturn]] void OnError(j_common_ptr jpeg) {
  JpegJob& job = JobOf(jpeg);
  jpeg->err->format_message(jpeg, job.message);
  std::longjmp(job.leave, 1);  // NOLINT(cert-err52-cpp)
}

// What libjpeg would repair in silence is damage; what it need not repair is none.
void OnMessage(j_common_ptr jpeg, int level) {
  if (level >= 0) return;
  const int code = jpeg->err->msg_code;
  if (code == JWRN_EXTRANEOUS_DATA || code == JWRN_ADOBE_XFORM || code == JWRN_JFIF_MAJOR) return;
  JobOf(jpeg).ended = code == JWRN_JPEG_EOF;
  OnError(jpeg);
}

void OnProgress(j_common_ptr jpeg) {
  JpegJob& job = JobOf(jpeg);
  job.cancelled = job.context != nullptr && job.context->cancelled();
  if (job.cancelled || job.jpeg.input_scan_number > kMostScans) {
    jpeg->err->msg_code = JERR_BAD_PROGRESSION;
    OnError(jpeg);
  }
}

void Prepare(JpegJob& job, std::span<const char> bytes) {
  job.jpeg.err = jpeg_std_error(&job.errors);
  job.errors.error_exit = OnError;
  job.errors.emit_message = OnMessage;
  job.jpeg.client_data = &job;
  // Before anything can fail: what is destroyed must be there.
  job.jpeg.mem = nullptr;
  if (setjmp(job.leave) != 0) return;  // NOLINT(cert-err52-cpp)
  jpeg_create_decompress(&job.jpeg);
  jpeg_mem_src(&job.jpeg, reinterpret_cast<const unsigned char*>(bytes.data()),
               static_cast<unsigned long>(bytes.size()));
}

bool RunHead(JpegJob& job) {
  if (setjmp(job.leave) != 0) return false;  // NOLINT(cert-err52-cpp)
  return jpeg_read_header(&job.jpeg, TRUE) == JPEG_HEADER_OK;
}

bool IsCmyk(const JpegJob& job) {
  return job.jpeg.jpeg_color_space == JCS_CMYK || job.jpeg.jpeg_color_space == JCS_YCCK;
}

// Inks to light. Adobe's programs, and all that follow them, store the inks' complements.
void ConvertCmyk(unsigned char* row, std::uint32_t width, bool complements) {
  for (std::uint32_t x = 0; x < width; ++x, row += 4) {
    const unsigned flip = complements ? 0 : 255;
    const unsigned black = row[3] ^ flip;
    for (int k = 0; k < 3; ++k) {
      row[k] = static_cast<unsigned char>(((row[k] ^ flip) * black + 127) / 255);
    }
    row[3] = 255;
  }
}

bool RunPixels(JpegJob& job) {
  if (setjmp(job.leave) != 0) return false;  // NOLINT(cert-err52-cpp)
  jpeg_decompress_struct& jpeg = job.jpeg;
  jpeg.out_color_space = IsCmyk(job) ? JCS_CMYK : JCS_EXT_RGBA;
  // The same bytes on every processor: the vector code of this one gives what plain code does.
  jpeg.dct_method = JDCT_ISLOW;
  jpeg.do_block_smoothing = FALSE;
  job.progress.progress_monitor = OnProgress;
  jpeg.progress = &job.progress;
  if (jpeg_start_decompress(&jpeg) == FALSE) return false;
  const std::size_t row = std::size_t{job.head->width} * 4;
  while (jpeg.output_scanline < jpeg.output_height) {
    unsigned char* to = job.pixels + jpeg.output_scanline * row;
    if (jpeg_read_scanlines(&jpeg, &to, 1) != 1) return false;
    if (IsCmyk(job)) ConvertCmyk(to, job.head->width, jpeg.saw_Adobe_marker != FALSE);
  }
  return jpeg_finish_decompress(&jpeg) != FALSE;
}

tl::unexpected<Error> Damaged(const JpegJob& job) {
  if (job.cancelled) return Cancelled();
  if (job.errors.msg_code == JERR_OUT_OF_MEMORY) {
    return Fail(ErrorCode::kOverBudget, "out of memory for libjpeg");
  }
  return Fail(ErrorCode::kCorruptInput,
              std::string("JPEG: ") + (job.ended ? "the image ends too early" : job.message));
}

// The head of a job that has read it.
Result<std::optional<ImageHead>> HeadOf(const JpegJob& job) {
  const jpeg_decompress_struct& jpeg = job.jpeg;
  ImageHead head;
  head.type = ImageType::kJpeg;
  head.width = jpeg.image_width;
  head.height = jpeg.image_height;
  head.channels = jpeg.num_components;
  head.bits = jpeg.data_precision;
  head.several_scans = jpeg_has_multiple_scans(const_cast<jpeg_decompress_struct*>(&jpeg)) != FALSE;
  const bool known = jpeg.jpeg_color_space == JCS_GRAYSCALE || jpeg.jpeg_color_space == JCS_RGB ||
                     jpeg.jpeg_color_space == JCS_YCbCr || IsCmyk(job);
  if (known && head.bits == 8) return std::optional(head);
  return Fail(ErrorCode::kUnsupported, "JPEG: " + std::to_string(head.channels) +
                                           " components of " + std::to_string(head.bits) +
                                           " bits are not read; expected 1, 3 or 4 of 8 bits");
}

}  // namespace

Result<std::optional<ImageHead>> ReadJpegHead(std::span<const char> front) {
  JpegJob job{};
  Prepare(job, front);
  const bool read = job.jpeg.src != nullptr && RunHead(job);
  Result<std::optional<ImageHead>> head;
  if (read) {
    head = HeadOf(job);
  } else if (!job.ended) {
    head = Damaged(job);
  }
  jpeg_destroy_decompress(&job.jpeg);
  return head;
}

Result<void> DecodeJpeg(std::span<const char> bytes, const ImageHead& head, unsigned char* pixels,
                        const RunContext* context) {
  JpegJob job{};
  job.context = context;
  job.head = &head;
  job.pixels = pixels;
  Prepare(job, bytes);
  const bool done = job.jpeg.src != nullptr && RunHead(job) && RunPixels(job);
  jpeg_destroy_decompress(&job.jpeg);
  return done ? Result<void>() : Damaged(job);
}

}  // namespace strata::io
