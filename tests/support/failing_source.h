// A byte source that breaks where a test wants it to.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "io/byte_source.h"

namespace strata::test {

/// Passes bytes on from `inner`, at most `most` a call, until byte `fail_at` would be read: that
/// read, and every later one that reaches it, is kIo. Bytes before it still arrive.
class FailingSource : public io::ByteSource {
 public:
  FailingSource(std::unique_ptr<io::ByteSource> inner, std::uint64_t fail_at,
                std::size_t most = SIZE_MAX)
      : inner_(std::move(inner)), fail_at_(fail_at), most_(most) {}

  Result<std::size_t> Read(std::span<char> out) override {
    if (position_ >= fail_at_) {
      return Fail(ErrorCode::kIo, name() + ": byte " + std::to_string(position_) + ": injected");
    }
    const std::uint64_t n = std::min<std::uint64_t>({out.size(), most_, fail_at_ - position_});
    auto got = inner_->Read(out.first(static_cast<std::size_t>(n)));
    if (got) position_ += *got;
    return got;
  }
  Result<void> Seek(std::uint64_t offset) override {
    position_ = offset;
    return inner_->Seek(offset);
  }
  bool can_read_at() const override { return inner_->can_read_at(); }
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) override {
    if (offset + out.size() <= fail_at_) return inner_->ReadAt(offset, out);
    return Fail(ErrorCode::kIo, name() + ": byte " + std::to_string(fail_at_) + ": injected");
  }
  std::optional<std::uint64_t> size() const override { return inner_->size(); }
  std::uint64_t stored_position() const override { return inner_->stored_position(); }
  std::optional<std::uint64_t> stored_size() const override { return inner_->stored_size(); }
  std::string compression() const override { return inner_->compression(); }
  const std::string& name() const override { return inner_->name(); }

 private:
  std::unique_ptr<io::ByteSource> inner_;
  std::uint64_t fail_at_, position_ = 0;
  std::size_t most_;
};

/// The same bytes as `inner`, in dribs of at most `most`, without failing.
inline std::unique_ptr<io::ByteSource> Dribble(std::unique_ptr<io::ByteSource> inner,
                                               std::size_t most) {
  return std::make_unique<FailingSource>(std::move(inner), UINT64_MAX, most);
}

}  // namespace strata::test
