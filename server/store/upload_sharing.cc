// UploadStore where several processes share the folder.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <ctime>

#include "io/output_place.h"
#include "server/store/upload_entry.h"
#include "server/store/upload_pieces.h"

namespace strata::server {
namespace {

// On a row of `uploads`: nobody who lives is at it.
constexpr const char* kFree =
    "(holder = '' OR NOT EXISTS (SELECT 1 FROM processes WHERE processes.id = holder))";

Result<void> CopyBytes(int from, int to, std::uint64_t size, const std::string& name) {
  std::vector<char> piece(1 << 20);
  for (std::uint64_t at = 0; at < size;) {
    const std::size_t now = std::min<std::uint64_t>(piece.size(), size - at);
    if (auto read = ReadFileAt(from, at, {piece.data(), now}, name); !read) return read;
    if (const int error = io::WriteAll(to, {piece.data(), now}, at); error != 0) {
      return FailSystem(name, "byte " + std::to_string(at) + ": cannot be written", error);
    }
  }
  if (fsync(to) != 0) return FailSystem(name, "cannot be synced to disk", errno);
  return {};
}

}  // namespace

// With mutex_ held. Shows here what other processes have done to the upload.
Result<void> UploadStore::Load(const std::string& id) {
  const auto present = entries_.find(id);
  if (present != entries_.end() && present->second->busy) return {};
  std::optional<UploadInfo> info;
  auto asked = parts_.database.Read().Query(
      "SELECT " + kUploadColumns + " FROM uploads WHERE id = ?",
      [&](const Row& row) { info = ReadUpload(row); }, id);
  if (!asked) return Forward(asked);
  if (!info) {
    entries_.erase(id);
    return {};
  }
  auto& entry = entries_[id];
  if (!entry) {
    entry = std::make_shared<Entry>();
    entry->share = NewShare();
  }
  // Bytes came by another process, or these here were not kept: the hash is not of what is there.
  if (entry->info.offset != info->offset || entry->info.file != info->file) {
    entry->hasher.reset();
    entry->here = info->offset;
  }
  if (info->offset == 0 && !entry->hasher) {
    entry->hasher.emplace();
    entry->hashed = 0;
  }
  entry->info = *std::move(info);
  return {};
}

// The entry is this thread's. Makes the row this process's too.
Result<void> UploadStore::Hold(Entry& entry) {
  const std::string id = entry.info.id, mine = parts_.blobs.membership().id();
  std::optional<UploadInfo> info;
  bool alive = false;
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    auto asked = session->Query(
        "SELECT " + kUploadColumns + " FROM uploads WHERE id = ? FOR UPDATE",
        [&](const Row& row) { info = ReadUpload(row); }, id);
    if (!asked) return Forward(asked);
    if (!info) return Fail(ErrorCode::kNotFound, "upload: there is none of this name");
    if (!info->holder.empty() && info->holder != mine) {
      auto looked = session->Query(
          "SELECT 1 FROM processes WHERE id = ?", [&](const Row&) { alive = true; }, info->holder);
      if (!looked) return Forward(looked);
    }
    auto changed = alive ? session->Query(
                               "SELECT pg_notify(current_schema() || '_uploads', ?)",
                               [](const Row&) {}, id + ' ' + info->holder)
                         : session->Run("UPDATE uploads SET holder = ? WHERE id = ?", mine, id);
    if (!changed) return Forward(changed);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (alive) {
    return Fail(ErrorCode::kConflict, "upload " + id +
                                          ": another request, at another process, is at "
                                          "it and was told to stop; try again");
  }
  const std::string former = info->holder;
  {
    const std::lock_guard lock(mutex_);
    unreleased_.erase(id);
    if (entry.info.offset != info->offset) {
      entry.hasher.reset();
      entry.here = info->offset;
    }
    entry.info = *info;
    entry.info.holder = mine;
  }
  if (pieces_ || former.empty() || former == mine || !entry.info.hash.empty()) return {};
  auto taken = TakeOver(entry, former);
  if (!taken) LetGo(entry);
  return taken;
}

// The former holder may be paused and go on: its file is left to it. The bytes before the durable
// offset are final, whoever writes.
Result<void> UploadStore::TakeOver(Entry& entry, const std::string& former) {
  UploadInfo info = entry.info;
  info.file = parts_.blobs.membership().NewName();
  const auto from = OpenFile(entry.info);
  const auto to = OpenFile(info, O_CREAT | O_EXCL);
  Result<void> copied;
  if (!from) copied = Forward(from);
  if (!to) copied = Forward(to);
  if (copied) copied = CopyBytes(from->get(), to->get(), info.offset, "uploads/" + info.file);
  if (copied) copied = SyncFolder(parts_.folder.uploads(), "uploads");
  bool named = false;
  if (copied) {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    if (auto alive = CheckAlive(*session, info.file); !alive) return alive;
    auto updated = session->Run("UPDATE uploads SET file = ? WHERE id = ? AND holder = ?",
                                info.file, info.id, info.holder);
    if (!updated) return Forward(updated);
    if (auto committed = session->Commit(); !committed) return committed;
    named = *updated == 1;
  }
  const std::string unused = named ? FileOf(entry.info) : info.file;
  unlinkat(parts_.folder.uploads().get(), unused.c_str(), 0);
  if (!copied) {
    // Still the former holder's file: who asks next must copy it, too.
    (void)parts_.database.Read().Run("UPDATE uploads SET holder = ? WHERE id = ? AND holder = ?",
                                     former, info.id, info.holder);
    return copied;
  }
  if (!named)
    return Fail(ErrorCode::kConflict, "upload " + info.id + ": another process took over");
  const std::lock_guard lock(mutex_);
  entry.info = info;
  entry.hasher.reset();
  return {};
}

Result<void> UploadStore::LetGoOf(const std::string& id, bool busy) {
  std::string holder;
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    if (found == entries_.end() || found->second->busy != busy) return {};
    holder = found->second->info.holder;
    found->second->info.holder.clear();
  }
  if (holder.empty()) return {};
  auto released = parts_.database.Read().Run(
      "UPDATE uploads SET holder = '' WHERE id = ? AND holder = ?", id, holder);
  if (!released) return Forward(released);
  return {};
}

void UploadStore::LetGo(Entry& entry) {
  const std::string holder = entry.info.holder;
  entry.share = NewShare();  // What is durable counts by its row.
  if (LetGoOf(entry.info.id, true)) return;
  const std::lock_guard lock(mutex_);
  entry.info.holder = holder;
  unreleased_.insert(entry.info.id);  // RemoveExpired tries again.
}

void UploadStore::StopAppend(const std::string& text) {
  // Everybody hears it, who asked as well, who may have the upload by then.
  const std::size_t space = std::min(text.find(' '), text.size());
  const std::string id = text.substr(0, space);
  if (space < text.size() && text.substr(space + 1) != parts_.blobs.membership().id()) return;
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found != entries_.end() && found->second->busy) found->second->stop = true;
}

Result<std::vector<std::string>> UploadStore::Abandoned(const std::string& condition) {
  std::vector<std::string> ids;
  auto listed = parts_.database.Read().Query(
      "SELECT id FROM uploads WHERE " + condition + " AND " + kFree,
      [&](const Row& row) { ids.push_back(row.Text(0)); }, ToMillis(parts_.clock.Now()));
  if (!listed) return Forward(listed);
  return ids;
}

Result<std::size_t> UploadStore::RemoveExpiredShared() {
  std::set<std::string> unreleased;
  {
    const std::lock_guard lock(mutex_);
    unreleased.swap(unreleased_);
  }
  for (const std::string& id : unreleased) {
    if (LetGoOf(id, false)) continue;
    const std::lock_guard lock(mutex_);
    unreleased_.insert(id);
  }
  // All bytes came, and the process that had them died before they became a model.
  const auto whole = Abandoned("length = \"offset\" AND hash IS NULL AND expires > ?");
  if (!whole) return Forward(whole);
  for (const std::string& id : *whole) (void)Head(id);
  const auto expired = Abandoned("expires <= ?");
  if (!expired) return Forward(expired);
  for (const std::string& id : *expired) {
    if (auto removed = RemoveUnheld(id); !removed) return Forward(removed);
  }
  if (auto removed = RemoveOldCopies(); !removed) return Forward(removed);
  return expired->size();
}

Result<void> UploadStore::RemoveUnheld(const std::string& id) {
  std::string file;
  {
    auto session = parts_.database.WriteRows();
    if (!session) return Forward(session);
    bool free = false;
    auto locked = session->Query(
        std::string("SELECT 1 FROM uploads WHERE id = ? AND ") + kFree + " FOR UPDATE",
        [&](const Row&) { free = true; }, id);
    if (!locked) return Forward(locked);
    if (!free) return {};
    if (pieces_) {
      if (auto doomed = UploadPieces::Doom(*session, id); !doomed) return doomed;
    }
    auto deleted = session->Query(
        "DELETE FROM uploads WHERE id = ? RETURNING file",
        [&](const Row& row) { file = row.Text(0); }, id);
    if (!deleted) return Forward(deleted);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (!file.empty()) unlinkat(parts_.folder.uploads().get(), file.c_str(), 0);
  const std::lock_guard lock(mutex_);
  if (const auto found = entries_.find(id); found != entries_.end() && !found->second->busy) {
    entries_.erase(found);
  }
  return {};
}

// --- Pieces in a bucket --------------------------------------------------------------------------

Result<void> UploadStore::StorePiece(Entry& entry, int fd, std::uint64_t end) {
  if (end == entry.info.offset) return StoreOffset(entry, end);
  UploadInfo info = entry.info;  // Only who has the entry occupied changes it.
  if (auto added = pieces_->Add(info, fd, end, Expiry()); !added) return added;
  const std::lock_guard lock(mutex_);
  entry.info = info;
  return {};
}

// An upload that went on, and ended, elsewhere leaves a file here. One that is being made has no
// row yet, but is young.
Result<void> UploadStore::RemoveOldCopies() {
  if (!pieces_) return {};
  constexpr std::time_t kYoungSeconds = 600;
  const int folder = parts_.folder.uploads().get();
  std::set<std::string> old;
  auto listed = ForEachName(folder, [&](const std::string& name) {
    struct stat status;
    if (fstatat(folder, name.c_str(), &status, AT_SYMLINK_NOFOLLOW) != 0) return;
    if (status.st_mtim.tv_sec < std::time(nullptr) - kYoungSeconds) old.insert(name);
  });
  if (!listed || old.empty()) return listed;
  auto rows = parts_.database.Read().Query("SELECT file FROM uploads WHERE hash IS NULL",
                                           [&](const Row& row) { old.erase(row.Text(0)); });
  if (!rows) return Forward(rows);
  for (const std::string& name : old) unlinkat(folder, name.c_str(), 0);
  return {};
}

}  // namespace strata::server
