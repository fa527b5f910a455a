#include "server/store/blob_store.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "io/output_place.h"
#include "server/store/schema.h"

namespace strata::server {
namespace {

constexpr std::uint64_t kReserveStepBytes = 1 << 20;

}  // namespace

std::string BlobStore::FileOf(const std::string& hash, const std::string& suffix) {
  return hash.substr(0, 2) + "/" + hash.substr(2) + (suffix.empty() ? "" : "." + suffix);
}

Result<std::unique_ptr<BlobStore>> BlobStore::Open(DataFolder& folder, Database& database,
                                                   Membership& membership, const BlobLimits& limits,
                                                   const BlobBucket& bucket) {
  std::unique_ptr<BlobStore> store(new BlobStore(folder, database, membership, limits, bucket));
  // Others are at work in a shared store: what Recover removes may be theirs.
  auto recovered = store->shared_ ? store->RemoveLeftovers() : store->Recover();
  if (recovered && store->shared_) recovered = store->CountBytes();
  if (!recovered) return Forward(recovered);
  return store;
}

Result<void> BlobStore::Recover() {
  if (bucket_) return RecoverBucket();
  std::set<std::string> known;
  {
    auto session = database_.Write();
    if (!session) return Forward(session);
    auto forgotten = session->Run(std::string("DELETE FROM blobs WHERE ") + kUnreferenced);
    if (!forgotten) return Forward(forgotten);
    recovery_.unreferenced = static_cast<std::uint64_t>(*forgotten);
    auto listed = session->Query("SELECT hash, size, kind FROM blobs", [&](const Row& row) {
      const auto size = static_cast<std::uint64_t>(row.Int(1));
      known.insert(row.Text(0));
      budget(static_cast<BlobKind>(row.Int(2))).Add(size);
      // A row's file was durable before the row: what is missing was taken away from outside.
      if (!HasFile(row.Text(0), {size, {}, 0})) recovery_.damaged.push_back(row.Text(0));
    });
    if (!listed) return Forward(listed);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  Result<void> swept;
  auto listed = ForEachName(folder_.blobs().get(), [&](const std::string& prefix) {
    if (swept) swept = SweepFolder(prefix, known);
  });
  if (!listed) return listed;
  return swept;
}

bool BlobStore::HasFile(const std::string& hash, const Entry& entry) const {
  struct stat status;
  const std::string path = FileOf(hash, entry.file);
  return fstatat(folder_.blobs().get(), path.c_str(), &status, AT_SYMLINK_NOFOLLOW) == 0 &&
         S_ISREG(status.st_mode) && static_cast<std::uint64_t>(status.st_size) == entry.size;
}

Result<void> BlobStore::SweepFolder(const std::string& prefix, const std::set<std::string>& known) {
  if (!IsHex(prefix, 2)) return {};  // Not ours.
  const Fd inner(openat(folder_.blobs().get(), prefix.c_str(),
                        O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  if (!inner) return FailSystem("blobs/" + prefix, "cannot open the folder", errno);
  return ForEachName(inner.get(), [&](const std::string& rest) {
    if (known.contains(prefix + rest)) return;
    if (unlinkat(inner.get(), rest.c_str(), 0) == 0) ++recovery_.orphan_files;
  });
}

Result<void> BlobStore::Reserve(DiskShare& share, BlobKind kind, std::uint64_t bytes) {
  // What does not fit there could never be sampled.
  const std::uint64_t most =
      bucket_ && kind == BlobKind::kModel ? bucket_.cache->limit_bytes() : UINT64_MAX;
  if (bytes > most || share.bytes() > most - bytes) {
    return Fail(ErrorCode::kOverBudget, "a model of " + std::to_string(share.bytes() + bytes) +
                                            " bytes or more: the cache "
                                            "of what lies in the bucket has " +
                                            std::to_string(most) + " (--blob-cache)");
  }
  if (auto free = CheckFreeSpace(bytes); !free) return free;
  if (shared_) (void)CountBytes();  // A count that is old is better than none.
  while (!share.Grow(bytes)) {
    const bool may_evict = kind == BlobKind::kResult && make_room_;
    if (!may_evict || bytes > budget(kind).limit() || !make_room_(bytes)) {
      return budget(kind).FailOver(bytes);
    }
  }
  return {};
}

Result<void> BlobStore::ReserveStep(DiskShare& share, BlobKind kind, std::uint64_t bytes) {
  if (bytes < kReserveStepBytes && share.Grow(kReserveStepBytes)) return {};
  return Reserve(share, kind, bytes);  // Near the limit a whole step may be too much.
}

Result<void> BlobStore::CheckFreeSpace(std::uint64_t bytes) const {
  struct statvfs disk;
  if (fstatvfs(folder_.blobs().get(), &disk) != 0) return {};  // The write itself will tell.
  const std::uint64_t free = std::uint64_t{disk.f_bavail} * disk.f_frsize;
  if (free >= keep_free_bytes_ && bytes <= free - keep_free_bytes_) return {};
  return Fail(ErrorCode::kIo, folder_.path() + ": " + std::to_string(bytes) + " bytes wanted, " +
                                  std::to_string(free) + " free on the disk, of which " +
                                  std::to_string(keep_free_bytes_) + " are kept free");
}

Result<BlobWriter> BlobStore::NewBlob(BlobKind kind, std::optional<std::uint64_t> size) {
  BlobWriter writer;
  writer.store_ = this;
  writer.kind_ = kind;
  writer.announced_ = size;
  writer.share_ = budget(kind).NewShare();
  if (auto reserved = Reserve(writer.share_, kind, size.value_or(0)); !reserved) {
    return Forward(reserved);
  }
  writer.name_ = membership_.NewName();
  const int flags = O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC;
  writer.fd_ = Fd(openat(folder_.incoming().get(), writer.name_.c_str(), flags, 0600));
  if (!writer.fd_) return FailSystem("incoming/" + writer.name_, "cannot be made", errno);
  return writer;
}

BlobWriter::~BlobWriter() { Discard(); }

void BlobWriter::Discard() {
  if (!fd_) return;
  unlinkat(store_->folder_.incoming().get(), name_.c_str(), 0);
  fd_ = Fd();
  share_ = DiskShare();
}

Result<void> BlobWriter::MakeRoom(std::uint64_t bytes) {
  if (announced_ && bytes > *announced_ - size_) {
    return Fail(ErrorCode::kInvalidArgument,
                "byte " + std::to_string(size_) + ": " + std::to_string(bytes) +
                    " bytes more found, the announced size is " + std::to_string(*announced_));
  }
  if (size_ + bytes <= share_.bytes()) return {};
  return store_->ReserveStep(share_, kind_, size_ + bytes - share_.bytes());
}

Result<void> BlobWriter::Write(std::string_view bytes) {
  if (!fd_) return Fail(ErrorCode::kInternal, name_ + ": written after its end");
  auto written = MakeRoom(bytes.size());
  if (written) {
    if (const int error = io::WriteAll(fd_.get(), bytes, size_); error != 0) {
      written = FailSystem("incoming/" + name_,
                           "byte " + std::to_string(size_) + ": cannot be written", error);
    }
  }
  hasher_.Update(bytes);
  if (!written) Discard();
  return written;
}

Result<BlobPin> BlobWriter::Commit() {
  if (!fd_) return Fail(ErrorCode::kInternal, name_ + ": committed twice");
  if (announced_ && size_ != *announced_) {
    return Fail(ErrorCode::kInvalidArgument, std::to_string(size_) + " bytes found, " +
                                                 std::to_string(*announced_) + " announced");
  }
  const std::string hash = hasher_.HexDigest();
  if (!IsHash(hash)) return Fail(ErrorCode::kInternal, name_ + ": no SHA-256");
  if (fsync(fd_.get()) != 0) {
    return FailSystem("incoming/" + name_, "cannot be synced to disk", errno);
  }
  return store_->Adopt({store_->folder_.incoming(), name_, hash, size_, kind_}, share_);
}

Result<BlobPin> BlobStore::Import(const std::string& name, BlobKind kind) {
  const std::string path = "incoming/" + name;
  const int incoming = folder_.incoming().get();
  const Fd fd(openat(incoming, name.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
  if (!fd) return FailSystem(path, "cannot be opened", errno);
  const auto import = [&]() -> Result<BlobPin> {
    const auto size = RegularFileSize(fd.get(), path);
    if (!size) return Forward(size);
    DiskShare share = budget(kind).NewShare();
    if (auto reserved = Reserve(share, kind, *size); !reserved) return Forward(reserved);
    const auto hash = HashFile(fd.get(), *size, path);
    if (!hash) return Forward(hash);
    if (fsync(fd.get()) != 0) return FailSystem(path, "cannot be synced to disk", errno);
    return Adopt({folder_.incoming(), name, *hash, *size, kind}, share);
  };
  auto pin = import();
  unlinkat(incoming, name.c_str(), 0);
  return pin;
}

Result<std::optional<BlobStore::Entry>> BlobStore::Find(const std::string& hash) {
  std::optional<Entry> entry;
  auto asked = database_.Read().Query(
      "SELECT size, file, touched FROM blobs WHERE hash = ?",
      [&](const Row& row) {
        entry = Entry{static_cast<std::uint64_t>(row.Int(0)), row.Text(1), row.Int(2)};
      },
      hash);
  if (!asked) return Forward(asked);
  return entry;
}

Result<BlobPin> BlobStore::Adopt(const Adoption& file, DiskShare& share) {
  if (bucket_) return AdoptInBucket(file, share);
  if (shared_) return AdoptShared(file, share);
  const std::lock_guard lock(mutex_);
  const auto known = Find(file.hash);
  if (!known) return Forward(known);
  if (!*known || !HasFile(file.hash, {file.size, {}, 0})) {
    if (auto linked = Link(file, {}); !linked) return Forward(linked);
  }
  if (!*known) {
    if (auto inserted = Insert(file, share); !inserted) {
      unlinkat(folder_.blobs().get(), FileOf(file.hash, {}).c_str(), 0);
      return Forward(inserted);
    }
  }
  return PinLocked(file.hash, file.size);
}

// A link and not a rename: until the row is there, the file keeps the name it had, and an upload
// that is cut short here can be finished again.
Result<void> BlobStore::Link(const Adoption& file, const std::string& suffix) {
  const std::string prefix = file.hash.substr(0, 2), rest = FileOf(file.hash, suffix).substr(3);
  const auto inner = OpenFolder(folder_.blobs().get(), prefix);
  if (!inner) return Forward(inner);
  const int from = file.folder.get();
  int done = linkat(from, file.name.c_str(), inner->get(), rest.c_str(), 0);
  if (done != 0 && errno == EEXIST) {
    // Left by an insertion that failed; there is no row, so nobody reads it.
    unlinkat(inner->get(), rest.c_str(), 0);
    done = linkat(from, file.name.c_str(), inner->get(), rest.c_str(), 0);
  }
  if (done != 0) return FailSystem(PathOf(file.hash), "cannot be made", errno);
  auto synced = SyncFolder(*inner, "blobs/" + prefix);
  if (!synced) unlinkat(inner->get(), rest.c_str(), 0);
  return synced;
}

Result<void> BlobStore::Insert(const Adoption& file, DiskShare& share) {
  auto session = database_.Write();
  if (!session) return Forward(session);
  auto inserted =
      session->Run("INSERT INTO blobs (hash, size, kind) VALUES (?, ?, ?)", file.hash,
                   static_cast<std::int64_t>(file.size), static_cast<std::int64_t>(file.kind));
  if (!inserted) return Forward(inserted);
  if (auto committed = session->Commit(); !committed) return committed;
  share.Keep(file.size);
  return {};
}

Result<BlobPin> BlobStore::Pin(const std::string& hash) {
  auto pinned = PinEntry(hash);
  if (!pinned) return Forward(pinned);
  return std::move(pinned->first);
}

Result<std::pair<BlobPin, std::string>> BlobStore::PinEntry(const std::string& hash) {
  const std::lock_guard lock(mutex_);
  const auto entry = Find(hash);
  if (!entry) return Forward(entry);
  if (shared_ && *entry) {
    const auto touched = Touch(hash, (*entry)->touched);
    if (!touched) return Forward(touched);
    if (!*touched) return Fail(ErrorCode::kNotFound, "no content with SHA-256 " + hash);
  }
  if (!*entry) return Fail(ErrorCode::kNotFound, "no content with SHA-256 " + hash);
  return std::pair(PinLocked(hash, (*entry)->size), (*entry)->file);
}

BlobPin BlobStore::PinLocked(const std::string& hash, std::uint64_t size) {
  ++pins_[hash];
  return BlobPin(this, hash, size);
}

Result<BlobReader> BlobStore::OpenBlobFile(const std::string& hash) {
  return bucket_ ? OpenInBucket(hash, /*as_file=*/true) : OpenBlob(hash);
}

Result<BlobReader> BlobStore::OpenBlob(const std::string& hash) {
  if (bucket_) return OpenInBucket(hash, /*as_file=*/false);
  auto pinned = PinEntry(hash);
  if (!pinned) return Forward(pinned);
  BlobPin pin = std::move(pinned->first);
  const std::string file = FileOf(hash, pinned->second);
  Fd fd(openat(folder_.blobs().get(), file.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!fd) {
    return Fail(ErrorCode::kIo, PathOf(hash) + ": cannot be opened: " + io::SystemReason(errno));
  }
  const auto size = RegularFileSize(fd.get(), PathOf(hash));
  if (!size) return Forward(size);
  if (*size != pin.size()) {
    return Fail(ErrorCode::kIo, PathOf(hash) + ": damaged: " + std::to_string(*size) +
                                    " bytes found, expected " + std::to_string(pin.size()));
  }
  return BlobReader{std::move(pin), std::move(fd), {}, {}};
}

bool BlobStore::IsPinned(const std::string& hash) const {
  const std::lock_guard lock(mutex_);
  return pins_.contains(hash);
}

void BlobStore::Unpin(const std::string& hash) {
  const std::lock_guard lock(mutex_);
  const auto pinned = pins_.find(hash);
  if (--pinned->second > 0) return;
  pins_.erase(pinned);
  CollectLocked(hash);
}

void BlobStore::Collect(const std::string& hash) {
  const std::lock_guard lock(mutex_);
  if (!pins_.contains(hash)) CollectLocked(hash);
}

Result<void> BlobStore::CollectAll() {
  static const std::string kList = std::string("SELECT hash FROM blobs WHERE ") + kUnreferenced;
  std::vector<std::string> hashes;
  {
    Session session = database_.Read();
    auto listed = session.Query(kList, [&](const Row& row) { hashes.push_back(row.Text(0)); });
    if (!listed) return Forward(listed);
  }
  for (const std::string& hash : hashes) Collect(hash);
  return {};
}

void BlobStore::CollectLocked(const std::string& hash) {
  if (bucket_) return CollectInBucket(hash);
  if (shared_) return CollectShared(hash);
  static const std::string kFind =
      std::string("SELECT size, kind FROM blobs WHERE hash = ? AND ") + kUnreferenced;
  std::optional<std::pair<std::uint64_t, BlobKind>> found;
  {
    Session session = database_.Read();
    const auto note = [&](const Row& row) {
      found.emplace(static_cast<std::uint64_t>(row.Int(0)), static_cast<BlobKind>(row.Int(1)));
    };
    if (!session.Query(kFind, note, hash) || !found) return;
    // Foreign keys refuse this if a reference came after all.
    if (!session.Run("DELETE FROM blobs WHERE hash = ?", hash)) return;
  }
  unlinkat(folder_.blobs().get(), FileOf(hash, {}).c_str(), 0);
  budget(found->second).Remove(found->first);
}

BlobPin::BlobPin(BlobPin&& other) noexcept
    : store_(std::exchange(other.store_, nullptr)),
      hash_(std::move(other.hash_)),
      size_(other.size_) {}

BlobPin& BlobPin::operator=(BlobPin&& other) noexcept {
  if (this != &other) {
    Release();
    store_ = std::exchange(other.store_, nullptr);
    hash_ = std::move(other.hash_);
    size_ = other.size_;
  }
  return *this;
}

void BlobPin::Release() {
  if (store_ != nullptr) std::exchange(store_, nullptr)->Unpin(hash_);
}

BlobPin::~BlobPin() { Release(); }

}  // namespace strata::server
