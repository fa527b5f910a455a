// Where a reader's bytes come from: a file, standard input, or either of them unpacked.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "core/scratch.h"
#include "io/fd.h"

namespace strata::io {

/// A rewindable stream of bytes. Threads: one at a time.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  /// Fills the front of `out`, returns how many bytes; 0 means the end. May return less than asked.
  /// Errors: kIo; kCorruptInput for damaged compressed data.
  virtual Result<std::size_t> Read(std::span<char> out) = 0;
  /// Goes to byte `offset` of the (unpacked) stream; compressed sources start over and skip.
  virtual Result<void> Seek(std::uint64_t offset) = 0;
  /// True if ReadAt works: plain files and memory.
  virtual bool can_read_at() const { return false; }
  /// Fills `out` from byte `offset` on, wherever Read stands. Errors: kIo (the end included).
  virtual Result<void> ReadAt(std::uint64_t offset, std::span<char> out);
  /// Size of the unpacked stream where that is known without reading it (never for compressed).
  virtual std::optional<std::uint64_t> size() const = 0;
  /// Bytes consumed of the input as stored, and the stored size: for progress.
  virtual std::uint64_t stored_position() const = 0;
  virtual std::optional<std::uint64_t> stored_size() const = 0;
  /// "none", "gzip" or "zstd".
  virtual std::string compression() const = 0;
  /// The name for messages.
  virtual const std::string& name() const = 0;
};

/// Opens a regular file, or "-": standard input. What cannot be rewound is copied first, to
/// `scratch` or, without it, to the system's directory for temporary files. Tells gzip and zstd by
/// their magic bytes. Errors: kNotFound, kIo.
Result<std::unique_ptr<ByteSource>> OpenByteSource(const std::string& path,
                                                   ScratchFolder* scratch = nullptr);

/// An open file as it is stored, not unpacked; `name` for messages. What cannot be rewound is
/// copied first. Errors: kNotFound (a directory), kIo.
Result<std::unique_ptr<ByteSource>> OpenByteSource(Fd fd, const std::string& name,
                                                   ScratchFolder* scratch);

/// `source` if ReadAt works on it; else its unpacked bytes, copied to `scratch` (the system's
/// without it), under its name and with its compression(). Stands at byte 0. Errors: those of
/// reading `source`; kIo.
Result<std::unique_ptr<ByteSource>> WithReadAt(std::unique_ptr<ByteSource> source,
                                               ScratchFolder* scratch);

/// A new file in `scratch`, or without it in the system's folder. Errors: kIo.
Result<std::unique_ptr<ScratchFile>> NewScratchFile(ScratchFolder* scratch);

/// The bytes of a string as a source; for tests and fuzzing. Unpacks gzip and zstd like a file.
std::unique_ptr<ByteSource> MemorySource(std::string bytes, std::string name = "memory");

/// A window over a ByteSource: look ahead, then consume.
class InputBuffer {
 public:
  explicit InputBuffer(ByteSource& source, std::size_t capacity = std::size_t{1} << 20);

  /// Makes at least `n` bytes available if the source has them (n <= capacity) and returns
  /// everything available; shorter than `n` only at the end of the source. The view is valid until
  /// the next Peek, Seek or destruction.
  Result<std::string_view> Peek(std::size_t n);
  /// Drops `n` bytes. Precondition: n <= what the last Peek returned, less what was consumed since.
  void Consume(std::size_t n) { begin_ += n; }
  /// Offset in the unpacked stream of the next byte to be consumed.
  std::uint64_t offset() const { return base_ + begin_; }
  Result<void> Seek(std::uint64_t offset);
  /// Somebody else moved the source: what is in the window is dropped. Only Seek may follow.
  void Forget();
  /// From now on nothing from byte `offset` on is read ahead of what a Peek asks for. Default: no
  /// limit.
  void LimitAhead(std::uint64_t offset) { ahead_ = offset; }
  ByteSource& source() { return source_; }

 private:
  ByteSource& source_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
  std::uint64_t base_ = 0;  // Stream offset of buffer_[0].
  std::uint64_t ahead_ = UINT64_MAX;
  bool at_end_ = false;
};

}  // namespace strata::io
