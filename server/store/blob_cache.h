// What came out of the bucket and is read as a file, kept on this machine while there is room.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "core/result.h"
#include "server/store/file.h"

namespace strata::server {

/// Copies of blobs in a folder of this process's alone, named by their SHA-256, within a number of
/// bytes: the least recently used goes first, and never one that is open. What a former process
/// left is hashed again before its first use. Threads: any.
class BlobCache {
 public:
  /// An open copy; it stays on disk, and counts, until the last File of it is gone.
  struct File {
    Fd fd;  ///< Of the whole content, read-only; a child process may inherit it.
    std::shared_ptr<const void> lease;
  };
  /// Writes the content to an empty file.
  using Fill = std::function<Result<void>(int fd)>;

  /// `folder` is emptied of what is no copy. Fetching leaves `keep_free_bytes` of its disk free.
  /// Errors: kIo.
  static Result<std::unique_ptr<BlobCache>> Open(Fd folder, std::uint64_t limit_bytes,
                                                 std::uint64_t keep_free_bytes = 0);

  /// Nothing if there is no copy whose hash is known to be right.
  std::optional<File> Find(const std::string& hash);
  /// The copy; `fill` is called if there is none, once however many ask. Waits up to 30 s for room
  /// that others have in use. Errors: of `fill`; kOverBudget (larger than the cache); kCorruptInput
  /// (what `fill` wrote has another hash or size), kIo (IsBucketAway when there was no room in the
  /// cache; a full disk), kCancelled (Meanwhile).
  Result<File> Get(const std::string& hash, std::uint64_t size, const Fill& fill);
  /// Keeps a second (hard) link of a file whose hash is known to be right, if there is room.
  void Keep(const Fd& folder, const std::string& name, const std::string& hash, std::uint64_t size);
  /// Removes the copy, if nobody has it open.
  void Forget(const std::string& hash);

  std::uint64_t used_bytes() const;
  std::uint64_t limit_bytes() const { return limit_; }

 private:
  enum class State : std::uint8_t { kUnknown, kFilling, kReady };
  struct Entry {
    std::uint64_t size = 0;
    std::uint64_t used = 0;  // In the order of use.
    std::uint64_t open = 0;
    State state = State::kUnknown;
  };
  BlobCache(Fd folder, std::uint64_t limit, std::uint64_t keep_free)
      : folder_(std::move(folder)), limit_(limit), keep_free_(keep_free) {}
  Result<void> TakeUp();
  std::optional<File> OpenLocked(const std::string& hash, Entry& entry);
  bool EvictOneLocked();
  bool HasRoomLocked(std::uint64_t size);
  Result<void> MakeRoom(std::unique_lock<std::mutex>& lock, std::uint64_t size);
  Result<void> MakeRoomOnDisk(std::uint64_t size);
  void RemoveLocked(const std::string& hash);
  Result<void> Check(const std::string& hash, std::uint64_t size) const;
  Result<void> Download(const std::string& hash, std::uint64_t size, const Fill& fill) const;

  const Fd folder_;
  const std::uint64_t limit_, keep_free_;
  mutable std::mutex mutex_;  // Guards all below.
  std::condition_variable changed_;
  std::map<std::string, Entry> entries_;
  std::uint64_t bytes_ = 0, uses_ = 0;
};

}  // namespace strata::server
