// BlobStore where several processes share the folder.
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <set>

#include "server/store/blob_store.h"
#include "server/store/schema.h"

namespace strata::server {

Result<BlobPin> BlobStore::AdoptShared(const Adoption& file, DiskShare& share) {
  BlobPin pin;  // From now on this process does not collect it.
  {
    const std::lock_guard lock(mutex_);
    pin = PinLocked(file.hash, file.size);
  }
  auto known = Find(file.hash);
  if (!known) return Forward(known);
  if (*known && HasFile(file.hash, **known)) {
    const auto touched = Touch(file.hash, 0);
    if (!touched) return Forward(touched);
    if (*touched) return pin;
  }
  const std::string suffix = membership_.NewName();
  const std::string damaged = *known ? (*known)->file : std::string();
  if (auto linked = Link(file, suffix); !linked) return Forward(linked);
  bool certain = true;
  const auto kept = InsertShared(file, suffix, damaged, certain);
  // The row may be there nevertheless: then the file stays until this process is gone.
  if (!kept && certain) unlinkat(folder_.blobs().get(), FileOf(file.hash, suffix).c_str(), 0);
  if (!kept) return Forward(kept);
  if (*kept == suffix) {
    share = DiskShare();
    budget(file.kind).Add(file.size);
  } else {
    // Somebody else stored the same meanwhile; no row will ever name this file.
    unlinkat(folder_.blobs().get(), FileOf(file.hash, suffix).c_str(), 0);
  }
  return pin;
}

// Returns which file the blob has. After an error that is not `certain` the row may be there.
Result<std::string> BlobStore::InsertShared(const Adoption& file, const std::string& suffix,
                                            const std::string& damaged, bool& certain) {
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  if (auto alive = CheckAlive(*session, suffix); !alive) return Forward(alive);
  const auto now = session->Now();
  if (!now) return Forward(now);
  std::string kept;
  auto inserted = session->Query(
      "INSERT INTO blobs (hash, size, kind, file, touched) VALUES (?1, ?2, ?3, ?4, ?5)"
      " ON CONFLICT (hash) DO UPDATE SET touched = excluded.touched,"
      " file = CASE WHEN blobs.file = ?6 THEN excluded.file ELSE blobs.file END RETURNING file",
      [&](const Row& row) { kept = row.Text(0); }, file.hash, file.size,
      static_cast<std::int64_t>(file.kind), suffix, ToMillis(*now), damaged);
  if (!inserted) return Forward(inserted);
  certain = false;
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return kept;
}

// Keeps the blob for another grace; a row that was touched a moment ago is left alone. Whether it
// is there.
Result<bool> BlobStore::Touch(const std::string& hash, std::int64_t touched) {
  Session session = database_.Read();
  const auto now = session.Now();
  if (!now) return Forward(now);
  if (touched > ToMillis(*now - grace_ / 2)) return true;
  auto updated = session.Run("UPDATE blobs SET touched = ? WHERE hash = ?", ToMillis(*now), hash);
  if (!updated) return Forward(updated);
  return *updated == 1;
}

void BlobStore::CollectShared(const std::string& hash) {
  static const std::string kDelete = std::string(
                                         "DELETE FROM blobs WHERE hash = ? AND touched <= ?"
                                         " AND ") +
                                     kUnreferenced + " RETURNING size, kind, file";
  std::string file;
  {
    Session session = database_.Read();
    const auto now = session.Now();
    if (!now) return;
    const auto note = [&](const Row& row) {
      file = row.Text(2);
      budget(static_cast<BlobKind>(row.Int(1))).Remove(static_cast<std::uint64_t>(row.Int(0)));
    };
    // Foreign keys refuse this if a reference came after all.
    if (!session.Query(kDelete, note, hash, ToMillis(*now - grace_))) return;
  }
  if (!file.empty()) unlinkat(folder_.blobs().get(), FileOf(hash, file).c_str(), 0);
}

Result<void> BlobStore::CountBytes() {
  std::uint64_t bytes[2] = {0, 0};
  auto counted = database_.Read().Query(
      "SELECT kind, CAST(sum(size) AS BIGINT) FROM blobs GROUP BY kind UNION ALL"
      " SELECT 0, CAST(coalesce(sum(coalesce(length, \"offset\")), 0) AS BIGINT) FROM uploads"
      " WHERE hash IS NULL",
      [&](const Row& row) {
        bytes[row.Int(0) == 0 ? 0 : 1] += static_cast<std::uint64_t>(row.Int(1));
      });
  if (!counted) return Forward(counted);
  models_.SetOnDisk(bytes[0]);
  results_.SetOnDisk(bytes[1]);
  return {};
}

Result<void> BlobStore::RemoveLeftovers() {
  if (bucket_) return RemoveBucketLeftovers();
  // The files first, then who lives, then the rows: a file that is listed, whose maker is dead and
  // which no row names, can get no row any more (CheckAlive).
  struct Found {
    const Fd* folder;
    std::string path, name;
  };
  std::vector<Found> files;
  const auto add = [&](const Fd& folder, const std::string& path, const std::string& name) {
    if (!MakerOf(name).empty()) files.push_back({&folder, path, name});
  };
  Result<void> inner;
  auto listed = ForEachName(folder_.blobs().get(), [&](const std::string& prefix) {
    if (!inner || !IsHex(prefix, 2)) return;
    const Fd fd(openat(folder_.blobs().get(), prefix.c_str(),
                       O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
    if (!fd) return;
    inner = ForEachName(fd.get(), [&](const std::string& rest) {
      const std::size_t dot = rest.find('.');
      if (dot != std::string::npos) {
        add(folder_.blobs(), prefix + "/" + rest, rest.substr(dot + 1));
      }
    });
  });
  if (listed) listed = inner;
  for (const Fd* folder : {&folder_.incoming(), &folder_.uploads()}) {
    if (!listed) return listed;
    listed = ForEachName(folder->get(), [&](const std::string& name) { add(*folder, name, name); });
  }
  if (!listed) return listed;
  const auto living = membership_.Living();
  if (!living) return Forward(living);
  const std::set<std::string, std::less<>> alive(living->begin(), living->end());
  std::erase_if(files, [&](const Found& file) { return alive.contains(MakerOf(file.name)); });
  if (files.empty()) return {};
  std::set<std::string> named;
  auto rows = database_.Read().Query(
      "SELECT file FROM blobs UNION ALL SELECT file FROM uploads WHERE hash IS NULL",
      [&](const Row& row) { named.insert(row.Text(0)); });
  if (!rows) return Forward(rows);
  for (const Found& file : files) {
    if (named.contains(file.name)) continue;
    if (unlinkat(file.folder->get(), file.path.c_str(), 0) == 0) ++recovery_.orphan_files;
  }
  return {};
}

}  // namespace strata::server
