#include "server/store/upload_store.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>
#include <vector>

#include "io/output_place.h"
#include "server/store/model_name.h"
#include "server/store/upload_entry.h"
#include "server/store/upload_pieces.h"

namespace strata::server {
namespace {

constexpr std::size_t kMaxMetadataBytes = 4096;

}  // namespace

const std::string kUploadColumns =
    "id, model, metadata, length, \"offset\", created, expires, hash, file, holder";

UploadInfo ReadUpload(const Row& row) {
  UploadInfo info;
  info.id = row.Text(0);
  info.model = row.Text(1);
  info.metadata = row.Text(2);
  if (const auto length = row.MaybeInt(3)) info.length = static_cast<std::uint64_t>(*length);
  info.offset = static_cast<std::uint64_t>(row.Int(4));
  info.created = FromMillis(row.Int(5));
  info.expires = FromMillis(row.Int(6));
  info.hash = row.Text(7);
  info.file = row.Text(8);
  info.holder = row.Text(9);
  return info;
}

namespace {

std::optional<std::int64_t> LengthOf(const UploadInfo& info) {
  if (!info.length) return std::nullopt;
  return static_cast<std::int64_t>(*info.length);
}

}  // namespace

UploadStore::UploadStore(const Parts& parts, const UploadLimits& limits)
    : parts_(parts),
      limits_(limits),
      shared_(parts.database.shared()),
      pieces_(shared_ && parts.blobs.bucket()
                  ? std::make_unique<UploadPieces>(parts.database, parts.blobs)
                  : nullptr) {}

UploadStore::~UploadStore() = default;

Result<std::unique_ptr<UploadStore>> UploadStore::Open(const Parts& parts,
                                                       const UploadLimits& limits) {
  std::unique_ptr<UploadStore> store(new UploadStore(parts, limits));
  if (auto recovered = store->Recover(); !recovered) return Forward(recovered);
  return store;
}

Result<void> UploadStore::Recover() {
  // Other processes are at work: what dead ones left is taken up when somebody asks for it.
  if (shared_) return {};
  std::vector<UploadInfo> rows;
  auto listed =
      parts_.database.Read().Query("SELECT " + kUploadColumns + " FROM uploads",
                                   [&](const Row& row) { rows.push_back(ReadUpload(row)); });
  if (!listed) return Forward(listed);
  for (const UploadInfo& info : rows) {
    if (auto resumed = Resume(info); !resumed) return resumed;
  }
  return RemoveStrangers();
}

Result<void> UploadStore::Resume(const UploadInfo& info) {
  auto entry = std::make_shared<Entry>();
  entry->info = info;
  entries_[info.id] = entry;
  if (!info.hash.empty()) return {};
  const auto fd = OpenFile(info);
  const auto size = fd ? RegularFileSize(fd->get(), info.id) : Result<std::uint64_t>(0);
  // The file was there before the row. Without it nothing can be resumed: the client begins anew.
  if (!fd || !size || *size < info.offset) return Remove(*entry);
  if (ftruncate(fd->get(), static_cast<off_t>(info.offset)) != 0) {
    return FailSystem("uploads/" + info.id, "cannot be cut back", errno);
  }
  entry->share =
      parts_.blobs.budget(BlobKind::kModel).TakeAnyway(info.length.value_or(info.offset));
  // A refusal (the name belongs to the repository by now) leaves it to expire.
  (void)CompleteIfWhole(*entry);
  return {};
}

Result<void> UploadStore::RemoveStrangers() {
  const int folder = parts_.folder.uploads().get();
  return ForEachName(folder, [&](const std::string& name) {
    const auto found = entries_.find(name);
    if (found == entries_.end() || !found->second->info.hash.empty()) {
      unlinkat(folder, name.c_str(), 0);
    }
  });
}

Result<Fd> UploadStore::OpenFile(const UploadInfo& info, int more_flags) const {
  const std::string& name = FileOf(info);
  // Of an upload in pieces another process may have had all the bytes until now.
  const int copy = pieces_ ? O_CREAT : 0;
  const int flags = O_RDWR | O_NOFOLLOW | O_CLOEXEC | copy | more_flags;
  Fd fd(openat(parts_.folder.uploads().get(), name.c_str(), flags, 0600));
  if (!fd) {
    return Fail(ErrorCode::kIo,
                "uploads/" + name + ": cannot be opened: " + io::SystemReason(errno));
  }
  return fd;
}

Result<void> UploadStore::CheckNew(const NewUpload& upload) {
  if (auto writable = parts_.models.CheckWritable(upload.model); !writable) return writable;
  if (upload.metadata.size() > kMaxMetadataBytes) {
    return Fail(ErrorCode::kInvalidArgument,
                "upload metadata: " + std::to_string(upload.metadata.size()) +
                    " bytes found, expected at most " + std::to_string(kMaxMetadataBytes));
  }
  if (upload.length.value_or(0) > limits_.max_bytes) {
    return Fail(ErrorCode::kOverBudget, "upload of " + std::to_string(*upload.length) +
                                            " bytes: expected at most " +
                                            std::to_string(limits_.max_bytes));
  }
  const auto open = CountOpen();
  if (!open) return Forward(open);
  if (*open < limits_.max_open) return {};
  return Fail(ErrorCode::kOverBudget,
              std::to_string(*open) + " uploads are unfinished, which is the limit");
}

Result<std::size_t> UploadStore::CountOpen() {
  std::int64_t count = 0;
  auto asked = parts_.database.Read().Query("SELECT count(*) FROM uploads WHERE hash IS NULL",
                                            [&](const Row& row) { count = row.Int(0); });
  if (!asked) return Forward(asked);
  return static_cast<std::size_t>(count);
}

Result<UploadInfo> UploadStore::Create(const NewUpload& upload) {
  if (auto checked = CheckNew(upload); !checked) return Forward(checked);
  auto entry = std::make_shared<Entry>();
  entry->share = parts_.blobs.budget(BlobKind::kModel).NewShare();
  auto reserved = parts_.blobs.Reserve(entry->share, BlobKind::kModel, upload.length.value_or(0));
  if (!reserved) return Forward(reserved);
  entry->hasher.emplace();
  entry->info = {RandomId(),
                 upload.model,
                 upload.metadata,
                 upload.length,
                 0,
                 parts_.clock.Now(),
                 Expiry(),
                 {},
                 {},
                 {}};
  const std::string id = entry->info.id;
  if (shared_) {
    entry->info.file = parts_.blobs.membership().NewName();
    entry->info.holder = MakerOf(entry->info.file);
  }
  const auto file = OpenFile(entry->info, O_CREAT | O_EXCL);
  if (!file) return Forward(file);
  auto stored = SyncFolder(parts_.folder.uploads(), "uploads");
  if (stored) stored = Insert(entry->info);
  if (!stored) {
    // Where the database was away the row may be there nevertheless: then the file has to be.
    if (!IsDatabaseAway(stored.error())) {
      unlinkat(parts_.folder.uploads().get(), FileOf(entry->info).c_str(), 0);
    }
    return Forward(stored);
  }
  if (shared_) entry->share = NewShare();  // The row counts.
  entry->busy = true;
  {
    const std::lock_guard lock(mutex_);
    entries_[id] = entry;
  }
  const auto completed = CompleteIfWhole(*entry);
  Leave(*entry);
  if (!completed) return Forward(completed);
  return InfoOf(*entry);
}

Result<void> UploadStore::Insert(const UploadInfo& info) {
  auto session = parts_.database.Write();
  if (!session) return Forward(session);
  if (auto alive = CheckAlive(*session, info.file); !alive) return alive;
  auto inserted = session->Run(
      "INSERT INTO uploads (id, model, metadata, length, \"offset\", created, expires, file, "
      "holder)"
      " VALUES (?, ?, ?, ?, 0, ?, ?, ?, ?)",
      info.id, info.model, info.metadata, LengthOf(info), ToMillis(info.created),
      ToMillis(info.expires), info.file, info.holder);
  if (!inserted) return Forward(inserted);
  return session->Commit();
}

Result<void> UploadStore::Update(Entry& entry, const UploadInfo& info) {
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    auto updated = session->Run(
        "UPDATE uploads SET length = ?, \"offset\" = ?, expires = ?, hash = nullif(?, '')"
        " WHERE id = ? AND holder = ?",
        LengthOf(info), static_cast<std::int64_t>(info.offset), ToMillis(info.expires), info.hash,
        info.id, info.holder);
    if (!updated) return Forward(updated);
    if (*updated != 1) {
      return Fail(ErrorCode::kConflict,
                  "upload " + info.id + ": another process took it over; go on from its offset");
    }
    if (pieces_ && !info.hash.empty()) {
      if (auto doomed = UploadPieces::Doom(*session, info.id); !doomed) return doomed;
    }
    if (auto committed = session->Commit(); !committed) return committed;
  }
  const std::lock_guard lock(mutex_);
  entry.info = info;
  return {};
}

Result<void> UploadStore::StoreOffset(Entry& entry, std::uint64_t offset) {
  UploadInfo info = entry.info;  // Only who has the entry occupied changes it.
  info.offset = offset;
  info.expires = Expiry();
  return Update(entry, info);
}

Result<std::shared_ptr<UploadStore::Entry>> UploadStore::Find(const std::string& id) {
  if (shared_) {
    if (auto loaded = Load(id); !loaded) return Forward(loaded);
  }
  const auto found = entries_.find(id);
  if (found == entries_.end() ||
      (!found->second->busy && found->second->info.expires <= parts_.clock.Now())) {
    return Fail(ErrorCode::kNotFound, "upload: there is none of this name, or it has expired");
  }
  return found->second;
}

Result<std::shared_ptr<UploadStore::Entry>> UploadStore::Occupy(const std::string& id) {
  std::unique_lock lock(mutex_);
  auto entry = Find(id);
  if (!entry) return entry;
  if ((*entry)->busy) {
    (*entry)->stop = true;
    return Fail(ErrorCode::kConflict,
                "upload " + id + ": another request is at it and was told to stop; try again");
  }
  (*entry)->busy = true;
  (*entry)->stop = false;
  lock.unlock();
  if (!shared_) return entry;
  if (auto held = Hold(**entry); !held) {
    lock.lock();
    (*entry)->busy = false;
    return Forward(held);
  }
  return entry;
}

void UploadStore::Leave(Entry& entry) {
  if (shared_) LetGo(entry);
  const std::lock_guard lock(mutex_);
  entry.busy = false;
}

Result<UploadInfo> UploadStore::InfoOf(const Entry& entry) {
  const std::lock_guard lock(mutex_);
  return entry.info;
}

Result<UploadInfo> UploadStore::Head(const std::string& id) {
  std::shared_ptr<Entry> entry;
  {
    const std::lock_guard lock(mutex_);
    auto found = Find(id);
    if (!found) return Forward(found);
    const UploadInfo& info = (*found)->info;
    const bool unfinished = info.hash.empty() && info.length == info.offset && !(*found)->busy;
    if (!unfinished) return info;
    entry = *found;
    if (!shared_) entry->busy = true;
  }
  if (shared_) {
    auto occupied = Occupy(id);
    // Somebody is at it: it is as it was.
    if (!occupied && occupied.error().code == ErrorCode::kConflict) return InfoOf(*entry);
    if (!occupied) return Forward(occupied);
    entry = *occupied;
  }
  // All bytes are there and what followed failed, for want of space perhaps. The client will send
  // nothing more, so this is the moment to try again.
  auto completed = CompleteIfWhole(*entry);
  Leave(*entry);
  if (!completed) return Forward(completed);
  return InfoOf(*entry);
}

Result<UploadInfo> UploadStore::SetLength(const std::string& id, std::uint64_t length) {
  auto entry = Occupy(id);
  if (!entry) return Forward(entry);
  const auto set = [&]() -> Result<void> {
    UploadInfo info = (*entry)->info;
    if (info.length == length) return {};
    if (info.length) {
      return Fail(ErrorCode::kConflict, "upload " + id + ": its length is " +
                                            std::to_string(*info.length) + ", found " +
                                            std::to_string(length));
    }
    if (length < info.offset) {
      return Fail(ErrorCode::kInvalidArgument,
                  "upload " + id + ": length " + std::to_string(length) + " found, " +
                      std::to_string(info.offset) + " bytes are here already");
    }
    if (length > limits_.max_bytes) {
      return Fail(ErrorCode::kOverBudget, "upload of " + std::to_string(length) +
                                              " bytes: expected at most " +
                                              std::to_string(limits_.max_bytes));
    }
    DiskShare& share = (*entry)->share;
    const std::uint64_t missing = length - std::min(length, share.bytes());
    auto reserved = parts_.blobs.Reserve(share, BlobKind::kModel, missing);
    if (!reserved) return reserved;
    info.length = length;
    info.expires = Expiry();
    if (auto updated = Update(**entry, info); !updated) return updated;
    if (shared_) share = NewShare();  // The row counts.
    return CompleteIfWhole(**entry);
  }();
  Leave(**entry);
  if (!set) return Forward(set);
  return InfoOf(**entry);
}

Result<std::string> UploadStore::HashOf(Entry& entry) {
  const std::uint64_t size = entry.info.offset;
  if (entry.hasher && entry.hashed == size) {
    std::string hash = entry.hasher->HexDigest();
    entry.hasher.reset();
    if (IsHash(hash)) return hash;
  }
  const auto fd = OpenFile(entry.info);
  if (!fd) return Forward(fd);
  if (pieces_ && entry.here > 0) {
    auto fetched = pieces_->Fetch(entry.info.id, fd->get(), entry.here);
    if (!fetched) return Forward(fetched);
    entry.here = 0;
  }
  return HashFile(fd->get(), size, "uploads/" + entry.info.id);
}

// Beyond the durable offset may lie what a failed append left.
Result<void> UploadStore::CutBack(const UploadInfo& info) const {
  const auto fd = OpenFile(info);
  if (!fd) return Forward(fd);
  const auto size = RegularFileSize(fd->get(), "uploads/" + info.id);
  if (!size) return Forward(size);
  if (*size <= info.offset || ftruncate(fd->get(), static_cast<off_t>(info.offset)) == 0) return {};
  return FailSystem("uploads/" + info.id, "cannot be cut back", errno);
}

// Each step may be repeated: after a crash before the last one the upload is still complete, and
// the next process goes through all of them again.
Result<void> UploadStore::CompleteIfWhole(Entry& entry) {
  UploadInfo info = entry.info;
  if (!info.hash.empty() || info.length != info.offset) return {};
  if (auto cut = CutBack(info); !cut) return cut;
  const auto hash = HashOf(entry);
  if (!hash) return Forward(hash);
  const auto pin = parts_.blobs.Adopt(
      {parts_.folder.uploads(), FileOf(info), *hash, info.offset, BlobKind::kModel}, entry.share);
  if (!pin) return Forward(pin);
  if (auto put = parts_.models.Put(info.model, *pin); !put) return Forward(put);
  info.hash = *hash;
  info.expires = Expiry();
  if (auto updated = Update(entry, info); !updated) return updated;
  unlinkat(parts_.folder.uploads().get(), FileOf(info).c_str(), 0);
  entry.share = DiskShare();
  return {};
}

Result<void> UploadStore::Terminate(const std::string& id) {
  auto entry = Occupy(id);
  if (!entry) return Forward(entry);
  auto removed = Remove(**entry);
  if (!removed) Leave(**entry);
  return removed;
}

Result<void> UploadStore::Remove(Entry& entry) {
  const std::string id = entry.info.id;
  {
    auto session = parts_.database.Write();
    if (!session) return Forward(session);
    if (pieces_) {
      if (auto doomed = UploadPieces::Doom(*session, id); !doomed) return doomed;
    }
    auto deleted =
        session->Run("DELETE FROM uploads WHERE id = ? AND holder = ?", id, entry.info.holder);
    if (!deleted) return Forward(deleted);
    if (*deleted != 1) {  // Then its pieces are another's, too.
      return Fail(ErrorCode::kConflict, "upload " + id + ": another process took it over");
    }
    if (auto committed = session->Commit(); !committed) return committed;
  }
  unlinkat(parts_.folder.uploads().get(), FileOf(entry.info).c_str(), 0);
  entry.share = DiskShare();
  const std::lock_guard lock(mutex_);
  entries_.erase(id);
  return {};
}

Result<std::size_t> UploadStore::RemoveExpired() {
  if (shared_) return RemoveExpiredShared();
  std::vector<std::shared_ptr<Entry>> expired;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, entry] : entries_) {
      if (entry->busy || entry->info.expires > parts_.clock.Now()) continue;
      entry->busy = true;
      expired.push_back(entry);
    }
  }
  Result<void> removed;
  for (const auto& entry : expired) {
    if (removed) removed = Remove(*entry);
    if (!removed) Leave(*entry);
  }
  if (!removed) return Forward(removed);
  return expired.size();
}

}  // namespace strata::server
