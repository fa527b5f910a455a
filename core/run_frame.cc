#include "core/run_frame.h"

#include <zstd.h>

#include <bit>
#include <utility>

namespace strata {
namespace {

static_assert(std::endian::native == std::endian::little, "runs are little endian");

constexpr std::size_t kMostRawBytes = RawBytes(kBlocksPerFrame, kMostCellsPerFrame, true);

}  // namespace

UnpackContext NewUnpackContext() { return {ZSTD_createDCtx(), ZSTD_freeDCtx}; }

FrameReader::FrameReader(const ScratchFile& file, const RunExtent& extent, ErrorCode damage,
                         UnpackContext context)
    : file_(file),
      damage_(damage),
      begin_(extent.offset),
      end_(extent.offset + extent.bytes),
      at_(extent.offset),
      next_(extent.offset),
      context_(std::move(context)) {}

Result<void> FrameReader::Read(std::uint64_t at) {
  at_ = at;
  FrameHeader header;
  if (at < begin_ || at > end_ || end_ - at < sizeof header) {
    return Damaged("it ends before its last frame");
  }
  auto read = file_.ReadAt(at, {reinterpret_cast<char*>(&header), sizeof header});
  if (!read) return read;
  if (header.raw_bytes < sizeof(ContentHeader) || header.raw_bytes > kMostRawBytes ||
      header.compressed_bytes > end_ - at - sizeof header ||
      header.compressed_bytes > ZSTD_compressBound(kMostRawBytes)) {
    return Damaged("a frame claims " + std::to_string(header.compressed_bytes) + " bytes for " +
                   std::to_string(header.raw_bytes));
  }
  compressed_.resize(header.compressed_bytes);
  read = file_.ReadAt(at + sizeof header, compressed_);
  if (!read) return read;
  raw_.resize(header.raw_bytes);
  const std::size_t n = ZSTD_decompressDCtx(context_.get(), raw_.data(), raw_.size(),
                                            compressed_.data(), compressed_.size());
  if (ZSTD_isError(n)) return Damaged(ZSTD_getErrorName(n));
  if (n != raw_.size()) return Damaged("a frame is shorter than it says");
  std::memcpy(&header_, raw_.data(), sizeof header_);
  next_ = at + sizeof header + header.compressed_bytes;
  return {};
}

tl::unexpected<Error> FrameReader::Damaged(const std::string& what) const {
  const std::string place = damage_ == ErrorCode::kIo ? "scratch space " : "";
  return Fail(damage_, place + file_.name() + ": the run from byte " + std::to_string(begin_) +
                           " is damaged at byte " + std::to_string(at_) + ": " + what);
}

}  // namespace strata
