#include "server/store/object_reader.h"

#include <algorithm>

namespace strata::server {
namespace {

constexpr std::size_t kLeastRange = std::size_t{1} << 20;

}  // namespace

Result<void> ObjectReader::ReadAt(std::uint64_t offset, std::span<char> out) {
  const std::lock_guard lock(mutex_);
  while (!out.empty()) {
    if (offset >= object_.size) {
      return Fail(ErrorCode::kIo, place_.Shown(object_.name) + ": byte " + std::to_string(offset) +
                                      ": the blob ends before");
    }
    if (offset < begin_ || offset - begin_ >= range_.size()) {
      if (auto loaded = Load(offset, out.size()); !loaded) return loaded;
    }
    const auto at = static_cast<std::size_t>(offset - begin_);
    const std::size_t count = std::min(out.size(), range_.size() - at);
    std::copy_n(range_.begin() + static_cast<std::ptrdiff_t>(at), count, out.begin());
    out = out.subspan(count);
    offset += count;
  }
  return {};
}

Result<void> ObjectReader::Load(std::uint64_t offset, std::size_t wanted) {
  keep_();
  const std::uint64_t size = std::min<std::uint64_t>(std::max(wanted, kLeastRange),  //
                                                     object_.size - offset);
  range_.resize(static_cast<std::size_t>(size));
  begin_ = offset;
  auto read = place_.Read(object_.name, offset, range_, object_.tag);
  if (!read) {
    range_.clear();
    if (read.error().code != ErrorCode::kConflict) return read;
    return FailObjectRefused(read.error().message);  // Who reads was told that it is there.
  }
  if (object_.hash.empty() || offset != hashed_) return {};
  hasher_.Update(range_);
  hashed_ += size;
  if (hashed_ < object_.size) return {};
  const std::string found = hasher_.HexDigest();
  if (found == object_.hash) return {};
  range_.clear();
  return FailObjectRefused(place_.Shown(object_.name) + ": damaged: SHA-256 " + found +
                           " found, expected " + object_.hash);
}

}  // namespace strata::server
