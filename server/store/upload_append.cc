#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "io/output_place.h"
#include "io/quote.h"
#include "server/store/upload_entry.h"
#include "server/store/upload_store.h"

namespace strata::server {
namespace {

Result<void> CheckChecksum(const std::optional<UploadChecksum>& checksum) {
  if (!checksum) return {};
  const std::size_t digits = checksum->kind == io::DigestKind::kSha1 ? 40 : 64;
  if (IsHex(checksum->hex, digits)) return {};
  return Fail(ErrorCode::kInvalidArgument, "checksum " + io::Quoted(checksum->hex) + ": expected " +
                                               std::to_string(digits) + " hex digits");
}

}  // namespace

Result<UploadAppend> UploadStore::Append(const std::string& id, std::uint64_t offset,
                                         std::optional<UploadChecksum> checksum) {
  if (auto checked = CheckChecksum(checksum); !checked) return Forward(checked);
  auto entry = Occupy(id);
  if (!entry) return Forward(entry);
  const UploadInfo& info = (*entry)->info;
  UploadAppend append;
  const auto begin = [&]() -> Result<void> {
    if (!info.hash.empty()) return Fail(ErrorCode::kConflict, "upload " + id + ": is finished");
    if (offset != info.offset) {
      return Fail(ErrorCode::kConflict, "upload " + id + ": offset " + std::to_string(offset) +
                                            " found, expected " + std::to_string(info.offset));
    }
    auto fd = OpenFile(info);
    if (!fd) return Forward(fd);
    append.fd_ = std::move(*fd);
    // Beyond the durable offset may lie what a failed append left.
    if (ftruncate(append.fd_.get(), static_cast<off_t>(offset)) != 0 ||
        lseek(append.fd_.get(), static_cast<off_t>(offset), SEEK_SET) < 0) {
      return FailSystem("uploads/" + id, "cannot be cut back", errno);
    }
    return {};
  }();
  if (!begin) {
    Leave(**entry);
    return Forward(begin);
  }
  if (checksum) append.checksum_hasher_ = io::Hasher(checksum->kind);
  append.store_ = this;
  append.entry_ = std::move(*entry);
  append.checksum_ = std::move(checksum);
  append.begin_ = append.position_ = offset;
  if (append.entry_->hashed != offset) append.entry_->hasher.reset();
  return append;
}

UploadAppend::UploadAppend(UploadAppend&& other) noexcept
    : store_(std::exchange(other.store_, nullptr)),
      entry_(std::move(other.entry_)),
      fd_(std::move(other.fd_)),
      checksum_(std::move(other.checksum_)),
      checksum_hasher_(std::move(other.checksum_hasher_)),
      begin_(other.begin_),
      position_(other.position_),
      failed_(other.failed_) {}

Result<void> UploadAppend::CheckRoom(std::uint64_t bytes) {
  const UploadInfo& info = entry_->info;
  const std::uint64_t limit = info.length.value_or(store_->limits_.max_bytes);
  if (bytes > limit - position_) {
    const ErrorCode code = info.length ? ErrorCode::kInvalidArgument : ErrorCode::kOverBudget;
    return Fail(code, "upload " + info.id + ": byte " + std::to_string(position_) + ": " +
                          std::to_string(bytes) + " bytes more found, expected at most " +
                          std::to_string(limit) + " in all");
  }
  // In a shared store the length that a row tells counts for it.
  const std::uint64_t told = store_->shared_ ? info.length.value_or(0) : 0;
  const std::uint64_t end = position_ + bytes, reserved = std::max(told, entry_->share.bytes());
  if (end <= reserved) return {};
  return store_->parts_.blobs.ReserveStep(entry_->share, BlobKind::kModel, end - reserved);
}

Result<void> UploadAppend::Write(std::string_view bytes) {
  if (store_ == nullptr || failed_) {
    return Fail(ErrorCode::kInternal, "upload: written after its end or an error");
  }
  auto written = WriteChecked(bytes);
  failed_ = !written;
  return written;
}

Result<void> UploadAppend::WriteChecked(std::string_view bytes) {
  if (entry_->stop) {
    return Fail(ErrorCode::kConflict, "upload " + entry_->info.id + ": another request took over");
  }
  if (auto room = CheckRoom(bytes.size()); !room) return room;
  if (const int error = io::WriteAll(fd_.get(), bytes, position_); error != 0) {
    entry_->hasher.reset();  // It has not seen the part that was written.
    return FailSystem("uploads/" + entry_->info.id,
                      "byte " + std::to_string(position_) + ": cannot be written", error);
  }
  if (checksum_) checksum_hasher_.Update(bytes);
  if (entry_->hasher) {
    entry_->hasher->Update(bytes);
    entry_->hashed = position_;
  }
  // Bytes that wait for their checksum must not count yet.
  const bool due = position_ - entry_->info.offset >= store_->limits_.sync_bytes;
  return due && !checksum_ ? MakeDurable() : Result<void>();
}

Result<void> UploadAppend::MakeDurable() {
  if (store_->pieces_) return store_->StorePiece(*entry_, fd_.get(), position_);
  if (fdatasync(fd_.get()) != 0) {
    return FailSystem("uploads/" + entry_->info.id, "cannot be synced to disk", errno);
  }
  return store_->StoreOffset(*entry_, position_);
}

Result<void> UploadAppend::Verify() {
  if (!checksum_) return {};
  const std::string found = failed_ ? "a failed write" : checksum_hasher_.HexDigest();
  if (found == checksum_->hex) return {};
  entry_->hasher.reset();
  position_ = begin_;
  const std::string name = "upload " + entry_->info.id;
  // What stays beyond the offset, should this fail, is cut off by the next append.
  if (ftruncate(fd_.get(), static_cast<off_t>(begin_)) != 0) {
    return FailSystem(name, "cannot be cut back", errno);
  }
  return Fail(ErrorCode::kCorruptInput, name + ": checksum " + found + " found from byte " +
                                            std::to_string(begin_) + " on, expected " +
                                            checksum_->hex);
}

// Keeps what came, as far as it may be kept.
Result<void> UploadAppend::Settle() {
  if (auto verified = Verify(); !verified) return verified;
  if (auto durable = MakeDurable(); !durable) return durable;
  return store_->CompleteIfWhole(*entry_);
}

Result<UploadInfo> UploadAppend::Finish() {
  if (store_ == nullptr) return Fail(ErrorCode::kInternal, "upload: finished twice");
  const auto settled = Settle();
  UploadStore* store = std::exchange(store_, nullptr);
  store->Leave(*entry_);
  if (!settled) return Forward(settled);
  if (failed_) return Fail(ErrorCode::kInternal, "upload: finished after an error");
  return store->InfoOf(*entry_);
}

UploadAppend::~UploadAppend() {
  if (store_ == nullptr) return;
  (void)Settle();  // The client is gone; what could be kept is told by its next Head.
  store_->Leave(*entry_);
}

}  // namespace strata::server
