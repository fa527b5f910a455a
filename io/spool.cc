#include "io/spool.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <string>
#include <utility>

namespace strata::io {

Result<std::unique_ptr<Spool>> Spool::Open(ScratchFolder* scratch, MemoryAccount* memory,
                                           std::uint64_t bytes, const std::string& what) {
  std::unique_ptr<Spool> spool(new Spool);
  if (scratch != nullptr) {
    auto file = scratch->NewFile();
    if (!file) return Forward(file);
    spool->file_ = std::move(*file);
    spool->buffer_.reserve(kBufferBytes);
  } else if (memory != nullptr) {
    auto share = memory->Take(bytes, what);
    if (!share) return Forward(share);
    spool->share_ = std::move(*share);
  }
  return spool;
}

Result<void> Spool::Append(std::string_view bytes) {
  size_ += bytes.size();
  if (file_ == nullptr) return Store(size_ - bytes.size(), bytes);
  if (buffer_.size() + bytes.size() > kBufferBytes) {
    if (auto flushed = Flush(); !flushed) return flushed;
  }
  if (bytes.size() >= kBufferBytes) return file_->Append(bytes);
  buffer_.append(bytes);
  return {};
}

Result<void> Spool::Flush() {
  auto written = buffer_.empty() ? Result<void>() : file_->Append(buffer_);
  buffer_.clear();
  return written;
}

Result<void> Spool::WriteAt(std::uint64_t offset, std::string_view bytes) {
  size_ = std::max(size_, offset + bytes.size());
  return file_ != nullptr ? file_->WriteAt(offset, bytes) : Store(offset, bytes);
}

Result<void> Spool::Store(std::uint64_t offset, std::string_view bytes) try {
  while (!bytes.empty()) {
    const std::uint64_t index = offset / kChunkBytes;
    const std::size_t at = offset % kChunkBytes;
    const std::size_t n = std::min(bytes.size(), kChunkBytes - at);
    if (chunks_.size() <= index) chunks_.resize(index + 1);
    if (chunks_[index] == nullptr) chunks_[index].reset(new char[kChunkBytes]);
    std::memcpy(chunks_[index].get() + at, bytes.data(), n);
    bytes.remove_prefix(n);
    offset += n;
  }
  return {};
} catch (const std::bad_alloc&) {
  return Fail(ErrorCode::kOverBudget, "out of memory after " + std::to_string(offset) +
                                          " bytes of samples; scratch space would hold them");
}

Result<void> Spool::Read(std::uint64_t offset, std::span<char> out) {
  if (out.size() > size_ || offset > size_ - out.size()) {
    return Fail(ErrorCode::kInternal, "spooled samples were read beyond their end");
  }
  if (file_ != nullptr) {
    if (auto flushed = Flush(); !flushed) return flushed;
    return file_->ReadAt(offset, out);
  }
  while (!out.empty()) {
    const std::size_t at = offset % kChunkBytes;
    const std::size_t n = std::min(out.size(), kChunkBytes - at);
    std::memcpy(out.data(), chunks_[offset / kChunkBytes].get() + at, n);
    out = out.subspan(n);
    offset += n;
  }
  return {};
}

void Spool::DiscardBefore(std::uint64_t end) {
  end = std::min(end, size_) / kChunkBytes * kChunkBytes;
  if (end <= discarded_) return;
  if (file_ != nullptr) file_->Discard(discarded_, end - discarded_);
  for (std::uint64_t k = discarded_; k < end && file_ == nullptr; k += kChunkBytes) {
    chunks_[k / kChunkBytes].reset();
  }
  discarded_ = end;
}

}  // namespace strata::io
