#include "io/compressed_source.h"

#include <zlib.h>
#include <zstd.h>
#include <zstd_errors.h>

#include <algorithm>
#include <limits>
#include <utility>

namespace strata::io {
namespace {

constexpr std::size_t kInputBytes = std::size_t{1} << 17;
constexpr int kMaxWindowLog = 27;  // 128 MiB, what the zstd command accepts unless told otherwise.

// What both unpackers share: a window of stored bytes, and a position in the unpacked stream.
class CompressedSource : public ByteSource {
 public:
  explicit CompressedSource(std::unique_ptr<ByteSource> stored)
      : stored_(std::move(stored)), input_(kInputBytes) {}

  Result<std::size_t> Read(std::span<char> out) override {
    if (out.empty()) return std::size_t{0};
    auto n = ReadUnpacked(out);
    if (n) position_ += *n;
    return n;
  }

  Result<void> Seek(std::uint64_t offset) override {
    if (offset < position_) {
      if (auto ok = stored_->Seek(0); !ok) return ok;
      begin_ = end_ = 0;
      stored_offset_ = position_ = 0;
      Restart();
    }
    return SkipTo(offset);
  }

  std::optional<std::uint64_t> size() const override { return std::nullopt; }
  std::uint64_t stored_position() const override { return stored_offset_ + begin_; }
  std::optional<std::uint64_t> stored_size() const override { return stored_->stored_size(); }
  const std::string& name() const override { return stored_->name(); }

 protected:
  virtual Result<std::size_t> ReadUnpacked(std::span<char> out) = 0;
  // Forgets all state: the next byte is the first of the stored data.
  virtual void Restart() = 0;

  std::span<const char> input() const { return {input_.data() + begin_, end_ - begin_}; }
  void ConsumeInput(std::size_t n) { begin_ += n; }

  // Replaces a used-up window by the next one; false at the end of the stored data.
  Result<bool> Refill() {
    stored_offset_ += begin_;
    begin_ = end_ = 0;
    auto n = stored_->Read(input_);
    if (!n) return Forward(n);
    end_ = *n;
    return end_ > 0;
  }

  tl::unexpected<Error> Damaged(const std::string& what,
                                ErrorCode code = ErrorCode::kCorruptInput) const {
    return Fail(code, name() + ": byte " + std::to_string(stored_position()) + " of the " +
                          compression() + " data: " + what);
  }
  tl::unexpected<Error> Truncated() const {
    return Damaged("the file ends here, expected more compressed data");
  }

 private:
  Result<void> SkipTo(std::uint64_t offset) {
    std::vector<char> waste(std::min<std::uint64_t>(offset - position_, std::uint64_t{1} << 16));
    while (position_ < offset) {
      const auto want = std::min<std::uint64_t>(offset - position_, waste.size());
      auto n = Read(std::span(waste).first(static_cast<std::size_t>(want)));
      if (!n) return Forward(n);
      if (*n == 0) break;
    }
    return {};
  }

  std::unique_ptr<ByteSource> stored_;
  std::vector<char> input_;
  std::size_t begin_ = 0, end_ = 0;
  std::uint64_t stored_offset_ = 0;  // Of input_[0].
  std::uint64_t position_ = 0;       // In the unpacked stream.
};

class GzipSource : public CompressedSource {
 public:
  explicit GzipSource(std::unique_ptr<ByteSource> stored) : CompressedSource(std::move(stored)) {
    ready_ = inflateInit2(&stream_, kGzipWindowBits) == Z_OK;
  }
  ~GzipSource() override { inflateEnd(&stream_); }
  GzipSource(const GzipSource&) = delete;
  GzipSource& operator=(const GzipSource&) = delete;

  bool ready() const { return ready_; }
  std::string compression() const override { return "gzip"; }

 protected:
  Result<std::size_t> ReadUnpacked(std::span<char> out) override {
    for (;;) {
      if (input().empty() && !flush_pending_) {
        auto more = Refill();
        if (!more) return Forward(more);
        if (!*more) {
          if (in_member_) return Truncated();
          return std::size_t{0};
        }
      }
      if (!in_member_) {
        auto began = BeginMember();
        if (!began) return Forward(began);
        if (!*began) continue;
      }
      auto n = Inflate(out);
      if (!n || *n > 0) return n;
    }
  }

  void Restart() override {
    inflateReset(&stream_);
    in_member_ = true;
    padding_ = flush_pending_ = false;
  }

 private:
  static constexpr int kGzipWindowBits = 15 + 16;  // zlib's code for "gzip header and trailer".

  // Between members: passes over padding; true when the next byte begins a member.
  Result<bool> BeginMember() {
    const auto bytes = input();
    const auto first = std::find_if(bytes.begin(), bytes.end(), [](char c) { return c != 0; });
    if (first != bytes.begin()) padding_ = true;
    ConsumeInput(static_cast<std::size_t>(first - bytes.begin()));
    if (input().empty()) return false;
    if (padding_ || static_cast<unsigned char>(input()[0]) != 0x1f) {
      return Damaged("found bytes after the last member, expected another member or the end");
    }
    inflateReset(&stream_);
    in_member_ = true;
    return true;
  }

  // One step of zlib; returns how many bytes came out, which may be none.
  Result<std::size_t> Inflate(std::span<char> out) {
    constexpr std::size_t kMost = std::numeric_limits<uInt>::max();
    const auto bytes = input();
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    stream_.next_out = reinterpret_cast<Bytef*>(out.data());
    stream_.avail_out = static_cast<uInt>(std::min(out.size(), kMost));
    const uInt room = stream_.avail_out;
    const int status = inflate(&stream_, Z_NO_FLUSH);
    ConsumeInput(bytes.size() - stream_.avail_in);
    flush_pending_ = stream_.avail_out == 0 && status != Z_STREAM_END;
    if (status == Z_STREAM_END) {
      in_member_ = false;
    } else if (status == Z_MEM_ERROR) {
      return Damaged("out of memory", ErrorCode::kOverBudget);
    } else if (status != Z_OK && status != Z_BUF_ERROR) {
      return Damaged(stream_.msg != nullptr ? stream_.msg : "not gzip data");
    }
    return std::size_t{room - stream_.avail_out};
  }

  z_stream stream_{};
  bool ready_ = false;
  bool in_member_ = true;
  bool padding_ = false;        // Zeros were seen after a member: no further member may follow.
  bool flush_pending_ = false;  // zlib may hold output that needs no further input.
};

class ZstdSource : public CompressedSource {
 public:
  explicit ZstdSource(std::unique_ptr<ByteSource> stored)
      : CompressedSource(std::move(stored)), stream_(ZSTD_createDStream()) {
    if (stream_ != nullptr) {
      ZSTD_DCtx_setParameter(stream_.get(), ZSTD_d_windowLogMax, kMaxWindowLog);
    }
  }

  bool ready() const { return stream_ != nullptr; }
  std::string compression() const override { return "zstd"; }

 protected:
  Result<std::size_t> ReadUnpacked(std::span<char> out) override {
    for (;;) {
      if (input().empty() && !flush_pending_) {
        auto more = Refill();
        if (!more) return Forward(more);
        if (!*more) {
          if (in_frame_) return Truncated();
          return std::size_t{0};
        }
      }
      auto n = Decompress(out);
      if (!n || *n > 0) return n;
    }
  }

  void Restart() override {
    ZSTD_DCtx_reset(stream_.get(), ZSTD_reset_session_only);
    in_frame_ = flush_pending_ = false;
  }

 private:
  struct FreeStream {
    void operator()(ZSTD_DStream* s) const { ZSTD_freeDStream(s); }
  };

  // One step of zstd; returns how many bytes came out, which may be none.
  Result<std::size_t> Decompress(std::span<char> out) {
    ZSTD_inBuffer in{input().data(), input().size(), 0};
    ZSTD_outBuffer to{out.data(), out.size(), 0};
    const std::size_t status = ZSTD_decompressStream(stream_.get(), &to, &in);
    ConsumeInput(in.pos);
    if (ZSTD_isError(status) != 0) {
      if (ZSTD_getErrorCode(status) == ZSTD_error_frameParameter_windowTooLarge) {
        return Damaged("the window is above the 128 MiB that Strata unpacks",
                       ErrorCode::kUnsupported);
      }
      return Damaged(ZSTD_getErrorName(status));
    }
    in_frame_ = status != 0;
    flush_pending_ = in_frame_ && to.pos == to.size;
    return to.pos;
  }

  std::unique_ptr<ZSTD_DStream, FreeStream> stream_;
  bool in_frame_ = false;
  bool flush_pending_ = false;  // zstd may hold output that needs no further input.
};

// Up to four bytes from the start; leaves the source at byte 0.
Result<std::string> Magic(ByteSource& source) {
  std::string magic(4, '\0');
  std::size_t have = 0;
  while (have < magic.size()) {
    auto n = source.Read(std::span(magic).subspan(have));
    if (!n) return Forward(n);
    if (*n == 0) break;
    have += *n;
  }
  magic.resize(have);
  if (auto ok = source.Seek(0); !ok) return Forward(ok);
  return magic;
}

bool IsZstd(std::string_view magic) {
  // A frame, or one of the sixteen kinds of skippable frame (pzstd begins with one).
  return magic == "\x28\xb5\x2f\xfd" ||
         (magic.size() == 4 && (magic[0] & 0xf0) == 0x50 && magic.substr(1) == "\x2a\x4d\x18");
}

template <class Source>
Result<std::unique_ptr<ByteSource>> Wrap(std::unique_ptr<ByteSource> stored) {
  auto source = std::make_unique<Source>(std::move(stored));
  if (!source->ready()) return Fail(ErrorCode::kOverBudget, source->name() + ": out of memory");
  return source;
}

}  // namespace

Result<std::unique_ptr<ByteSource>> Unpack(std::unique_ptr<ByteSource> stored) {
  auto magic = Magic(*stored);
  if (!magic) return Forward(magic);
  if (magic->starts_with("\x1f\x8b")) return Wrap<GzipSource>(std::move(stored));
  if (IsZstd(*magic)) return Wrap<ZstdSource>(std::move(stored));
  return stored;
}

}  // namespace strata::io
