// Frames: what a run consists of on disk. For the files that write and read runs;
// docs/run-format.md has the layout.
#pragma once

#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>

#include "core/result.h"
#include "core/run_file.h"
#include "core/scratch.h"
#include "core/vec3.h"

struct ZSTD_DCtx_s;

namespace strata {

struct FrameHeader {
  std::uint32_t compressed_bytes, raw_bytes;
};
/// Flags of a frame.
inline constexpr std::uint32_t kHasBarycentric = 1, kIsEnd = 2, kIsIndex = 4, kIsDirectory = 8;
struct ContentHeader {
  std::uint32_t flags, blocks, cells, frames;
};
struct EndContent {
  ContentHeader header;
  std::uint64_t blocks, cells, spread, directory_bytes;
};
/// Bytes of the last frame, which stands before this at the end of a run.
using RunTrailer = std::uint32_t;

/// A frame ends with the block that brings it to either.
inline constexpr std::size_t kCellsPerFrame = 1024, kBlocksPerFrame = 256;
inline constexpr std::size_t kMostCellsPerFrame = kCellsPerFrame + 512;
/// An index frame follows the frame that brings what it has to tell of to this.
inline constexpr std::size_t kBlocksPerIndex = 128;
inline constexpr std::size_t kMostBlocksPerIndex = kBlocksPerIndex + kBlocksPerFrame;

/// Bytes of a frame of reservoirs, unpacked, of at most kBlocksPerFrame blocks.
constexpr std::size_t RawBytes(std::size_t blocks, std::size_t cells, bool barycentric) {
  return sizeof(ContentHeader) + blocks * (sizeof(Cell) + 2) + cells * (2 + 8 * 7 + 12) +
         (barycentric ? cells * 16 : 0);
}

/// Columns one after another, each value as it lies in memory.
class ColumnWriter {
 public:
  explicit ColumnWriter(std::string& out) : out_(out) { out_.clear(); }
  template <class T>
  void Put(const T& value) {
    out_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  template <class Range, class F>
  void Column(const Range& range, F&& value_of) {
    for (const auto& element : range) Put(value_of(element));
  }

 private:
  std::string& out_;
};

/// Reads what ColumnWriter wrote. Precondition throughout: the sizes were checked.
class ColumnReader {
 public:
  explicit ColumnReader(std::string_view in) : in_(in) {}
  template <class T>
  void Get(T& value) {
    std::memcpy(&value, in_.data(), sizeof value);
    in_.remove_prefix(sizeof value);
  }
  template <class Range, class F>
  void Column(Range& range, F&& place_of) {
    for (auto& element : range) Get(place_of(element));
  }

 private:
  std::string_view in_;
};

/// What unpacks frames; several readers of one thread may share it.
using UnpackContext = std::shared_ptr<ZSTD_DCtx_s>;
UnpackContext NewUnpackContext();

/// Reads and unpacks single frames of a run, with their checksums. Threads: one.
class FrameReader {
 public:
  /// `damage`: as RunReader's.
  FrameReader(const ScratchFile& file, const RunExtent& extent, ErrorCode damage,
              UnpackContext context);

  /// Unpacks the frame at byte `at` of the file. Errors: kIo; `damage`.
  Result<void> Read(std::uint64_t at);
  /// Of the frame that was read, until the next one is.
  std::string_view content() const { return raw_; }
  const ContentHeader& header() const { return header_; }
  std::uint64_t at() const { return at_; }
  std::uint64_t next() const { return next_; }  ///< The byte after it.

  std::uint64_t begin() const { return begin_; }
  std::uint64_t end() const { return end_; }
  const ScratchFile& file() const { return file_; }
  /// "… is damaged at byte …: what", the byte being that of the last frame that was tried.
  tl::unexpected<Error> Damaged(const std::string& what) const;

 private:
  const ScratchFile& file_;
  ErrorCode damage_;
  std::uint64_t begin_, end_, at_, next_;
  std::string compressed_, raw_;
  ContentHeader header_{};
  UnpackContext context_;
};

}  // namespace strata
