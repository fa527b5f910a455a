// A byte source that counts what is read of it.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "io/byte_source.h"

namespace strata::test {

/// Adds the bytes that `inner` gives, however often the same ones, to `*count`, which outlives it.
class CountingSource : public io::ByteSource {
 public:
  CountingSource(std::unique_ptr<io::ByteSource> inner, std::uint64_t* count)
      : inner_(std::move(inner)), count_(count) {}

  Result<std::size_t> Read(std::span<char> out) override {
    auto got = inner_->Read(out);
    if (got) *count_ += *got;
    return got;
  }
  Result<void> Seek(std::uint64_t offset) override { return inner_->Seek(offset); }
  bool can_read_at() const override { return inner_->can_read_at(); }
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) override {
    *count_ += out.size();
    return inner_->ReadAt(offset, out);
  }
  std::optional<std::uint64_t> size() const override { return inner_->size(); }
  std::uint64_t stored_position() const override { return inner_->stored_position(); }
  std::optional<std::uint64_t> stored_size() const override { return inner_->stored_size(); }
  std::string compression() const override { return inner_->compression(); }
  const std::string& name() const override { return inner_->name(); }

 private:
  std::unique_ptr<io::ByteSource> inner_;
  std::uint64_t* count_;
};

}  // namespace strata::test
