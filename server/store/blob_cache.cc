#include "server/store/blob_cache.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <tuple>
#include <utility>
#include <vector>

#include "core/run_context.h"
#include "server/store/object_place.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::seconds kPatience{30};

}  // namespace

Result<std::unique_ptr<BlobCache>> BlobCache::Open(Fd folder, std::uint64_t limit_bytes,
                                                   std::uint64_t keep_free_bytes) {
  std::unique_ptr<BlobCache> cache(new BlobCache(std::move(folder), limit_bytes, keep_free_bytes));
  if (auto taken = cache->TakeUp(); !taken) return Forward(taken);
  return cache;
}

Result<void> BlobCache::TakeUp() {
  std::vector<std::tuple<std::int64_t, std::string, std::uint64_t>> found;  // By time of last use.
  auto listed = ForEachName(folder_.get(), [&](const std::string& name) {
    struct stat status;
    const bool known = IsHash(name) &&
                       fstatat(folder_.get(), name.c_str(), &status, AT_SYMLINK_NOFOLLOW) == 0 &&
                       S_ISREG(status.st_mode);
    if (!known) {
      unlinkat(folder_.get(), name.c_str(), 0);
      return;
    }
    const std::int64_t nanoseconds =
        std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec;
    found.emplace_back(nanoseconds, name, static_cast<std::uint64_t>(status.st_size));
  });
  if (!listed) return listed;
  std::ranges::sort(found);
  const std::lock_guard lock(mutex_);
  for (const auto& [when, name, size] : found) {
    entries_[name] = {size, ++uses_, 0, State::kUnknown};
    bytes_ += size;
  }
  HasRoomLocked(0);
  return {};
}

std::uint64_t BlobCache::used_bytes() const {
  const std::lock_guard lock(mutex_);
  return bytes_;
}

void BlobCache::RemoveLocked(const std::string& hash) {
  const auto found = entries_.find(hash);
  unlinkat(folder_.get(), hash.c_str(), 0);
  bytes_ -= found->second.size;
  entries_.erase(found);
}

bool BlobCache::EvictOneLocked() {
  const auto idle = [](const auto& each) {
    return each.second.open == 0 && each.second.state != State::kFilling;
  };
  const auto older = [&](const auto& a, const auto& b) {
    if (idle(a) != idle(b)) return idle(a);
    return a.second.used < b.second.used;
  };
  const auto oldest = std::ranges::min_element(entries_, older);
  if (oldest == entries_.end() || !idle(*oldest)) return false;
  RemoveLocked(std::string(oldest->first));
  return true;
}

bool BlobCache::HasRoomLocked(std::uint64_t size) {
  while (bytes_ > limit_ || size > limit_ - bytes_) {
    if (!EvictOneLocked()) return false;
  }
  return true;
}

// A full disk is nobody's fault who has copies open: it is told at once.
Result<void> BlobCache::MakeRoomOnDisk(std::uint64_t size) {
  struct statvfs disk;
  // Where it cannot be asked, the writing itself will tell.
  while (fstatvfs(folder_.get(), &disk) == 0) {
    const std::uint64_t free = std::uint64_t{disk.f_bavail} * disk.f_frsize;
    if (free >= keep_free_ && size <= free - keep_free_) break;
    if (EvictOneLocked()) continue;
    return Fail(ErrorCode::kIo, "cache: " + std::to_string(size) + " bytes wanted, " +
                                    std::to_string(free) + " free on the disk, of which " +
                                    std::to_string(keep_free_) + " are kept free");
  }
  return {};
}

Result<void> BlobCache::MakeRoom(std::unique_lock<std::mutex>& lock, std::uint64_t size) {
  const auto deadline = std::chrono::steady_clock::now() + kPatience;
  while (!HasRoomLocked(size)) {
    if (std::chrono::steady_clock::now() > deadline) {
      return FailBucketAway("its cache has no room for " + std::to_string(size) +
                            " bytes: all of its " + std::to_string(limit_) +
                            " are in use; come again");
    }
    changed_.wait_for(lock, kTick);
    lock.unlock();
    const bool gone = Meanwhile::Gone();
    lock.lock();
    if (gone) return Cancelled();
  }
  return MakeRoomOnDisk(size);
}

std::optional<BlobCache::File> BlobCache::OpenLocked(const std::string& hash, Entry& entry) {
  File file;
  file.fd = Fd(openat(folder_.get(), hash.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!file.fd) return std::nullopt;
  entry.used = ++uses_;
  ++entry.open;
  // For the order in which the next process finds them.
  utimensat(folder_.get(), hash.c_str(), nullptr, AT_SYMLINK_NOFOLLOW);
  file.lease = std::shared_ptr<const void>(static_cast<const void*>(this), [this, hash](auto) {
    {
      const std::lock_guard lock(mutex_);
      const auto found = entries_.find(hash);  // Missing: taken away from outside.
      if (found != entries_.end() && found->second.open > 0) --found->second.open;
    }
    changed_.notify_all();
  });
  return file;
}

std::optional<BlobCache::File> BlobCache::Find(const std::string& hash) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(hash);
  if (found == entries_.end() || found->second.state != State::kReady) return std::nullopt;
  return OpenLocked(hash, found->second);
}

Result<void> BlobCache::Check(const std::string& hash, std::uint64_t size) const {
  const Fd fd(openat(folder_.get(), hash.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!fd) return FailSystem("cache/" + hash, "cannot be opened", errno);
  const auto found_size = RegularFileSize(fd.get(), "cache/" + hash);
  if (!found_size) return Forward(found_size);
  const auto found = HashFile(fd.get(), *found_size, "cache/" + hash);
  if (!found) return Forward(found);
  if (*found == hash && *found_size == size) return {};
  return Fail(ErrorCode::kCorruptInput, "cache/" + hash + ": " + std::to_string(*found_size) +
                                            " bytes of SHA-256 " + *found + " found, expected " +
                                            std::to_string(size));
}

Result<void> BlobCache::Download(const std::string& hash, std::uint64_t size,
                                 const Fill& fill) const {
  const std::string draft = hash + ".part";
  const int flags = O_RDWR | O_CREAT | O_TRUNC | O_NOFOLLOW | O_CLOEXEC;
  const Fd fd(openat(folder_.get(), draft.c_str(), flags, 0600));
  if (!fd) return FailSystem("cache/" + draft, "cannot be made", errno);
  Result<void> done = fill(fd.get());
  if (done && renameat(folder_.get(), draft.c_str(), folder_.get(), hash.c_str()) != 0) {
    done = FailSystem("cache/" + draft, "cannot be renamed", errno);
  }
  if (done) done = Check(hash, size);
  if (!done) {
    unlinkat(folder_.get(), draft.c_str(), 0);
    unlinkat(folder_.get(), hash.c_str(), 0);
  }
  return done;
}

Result<BlobCache::File> BlobCache::Get(const std::string& hash, std::uint64_t size,
                                       const Fill& fill) {
  if (size > limit_) {
    return Fail(ErrorCode::kOverBudget, "a blob of " + std::to_string(size) +
                                            " bytes: the cache has " + std::to_string(limit_) +
                                            " (--blob-cache)");
  }
  std::unique_lock lock(mutex_);
  for (auto found = entries_.find(hash); found != entries_.end(); found = entries_.find(hash)) {
    if (found->second.state == State::kReady) {
      auto file = OpenLocked(hash, found->second);
      if (file) return *std::move(file);
      RemoveLocked(hash);  // Taken away from outside.
      break;
    }
    if (found->second.state == State::kUnknown) {
      found->second.state = State::kFilling;
      lock.unlock();
      const auto whole = Check(hash, size);
      lock.lock();
      entries_[hash].state = State::kReady;
      if (!whole) RemoveLocked(hash);
      changed_.notify_all();
      continue;
    }
    changed_.wait_for(lock, kTick);  // Another thread is at it.
    lock.unlock();
    const bool gone = Meanwhile::Gone();
    lock.lock();
    if (gone) return Cancelled();
  }
  if (auto room = MakeRoom(lock, size); !room) return Forward(room);
  if (entries_.contains(hash)) {  // It came while this thread waited for room.
    lock.unlock();
    return Get(hash, size, fill);
  }
  entries_[hash] = {size, ++uses_, 0, State::kFilling};
  bytes_ += size;
  lock.unlock();
  const auto filled = Download(hash, size, fill);
  lock.lock();
  Entry& entry = entries_[hash];
  entry.state = State::kReady;
  std::optional<File> file;
  if (filled) file = OpenLocked(hash, entry);
  if (!file) RemoveLocked(hash);
  changed_.notify_all();
  if (!filled) return Forward(filled);
  if (!file) return Fail(ErrorCode::kIo, "cache/" + hash + ": went away");
  return *std::move(file);
}

void BlobCache::Keep(const Fd& folder, const std::string& name, const std::string& hash,
                     std::uint64_t size) {
  const std::lock_guard lock(mutex_);
  if (entries_.contains(hash) || size > limit_ || !HasRoomLocked(size)) return;
  if (linkat(folder.get(), name.c_str(), folder_.get(), hash.c_str(), 0) != 0) return;
  entries_[hash] = {size, ++uses_, 0, State::kReady};
  bytes_ += size;
}

void BlobCache::Forget(const std::string& hash) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(hash);
  if (found == entries_.end() || found->second.open > 0) return;
  if (found->second.state != State::kFilling) RemoveLocked(hash);
}

}  // namespace strata::server
