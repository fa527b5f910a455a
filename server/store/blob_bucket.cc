// BlobStore where the content lies in a bucket.
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <map>
#include <utility>

#include "server/store/blob_store.h"
#include "server/store/schema.h"

namespace strata::server {
namespace {

constexpr std::string_view kBlobs = "blobs/", kPieces = "uploads/";
constexpr int kMostRefused = 20;  // Of one sweep.

// What an object's name ends with: its maker's (Membership::NewName).
std::string_view MakersPart(std::string_view object) {
  if (object.starts_with(kPieces)) return object.substr(kPieces.size());
  const std::size_t dot = object.find('.');
  return dot == object.npos ? std::string_view() : object.substr(dot + 1);
}

Result<void> Doom(Session& session, const std::string& object) {
  auto noted = session.Run(
      "INSERT INTO blob_garbage (name) VALUES (?) ON CONFLICT (name) DO NOTHING", object);
  if (!noted) return Forward(noted);
  return {};
}

}  // namespace

std::string BlobStore::ObjectOf(const std::string& hash, const std::string& suffix) {
  return std::string(kBlobs) + FileOf(hash, suffix);
}

// The data folder's lock says that nobody else is at work in this bucket's prefix.
Result<void> BlobStore::RecoverBucket() {
  std::map<std::string, std::uint64_t> listed;
  const auto note = [&](const std::string& name, std::uint64_t size) { listed[name] = size; };
  if (auto done = bucket_.place->List(std::string(kBlobs), note); !done) return done;
  {
    auto session = database_.Write();
    if (!session) return Forward(session);
    auto forgotten = session->Run(std::string("DELETE FROM blobs WHERE ") + kUnreferenced);
    if (!forgotten) return Forward(forgotten);
    recovery_.unreferenced = static_cast<std::uint64_t>(*forgotten);
    auto rows = session->Query("SELECT hash, size, kind, file FROM blobs", [&](const Row& row) {
      const auto size = static_cast<std::uint64_t>(row.Int(1));
      budget(static_cast<BlobKind>(row.Int(2))).Add(size);
      const auto found = listed.extract(ObjectOf(row.Text(0), row.Text(3)));
      if (found.empty() || found.mapped() != size) recovery_.damaged.push_back(row.Text(0));
    });
    if (!rows) return Forward(rows);
    for (const auto& [name, size] : listed) {
      if (auto doomed = Doom(*session, name); !doomed) return doomed;
      ++recovery_.orphan_files;
    }
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (auto aborted = AbortUnfinished({}); !aborted) return aborted;
  auto swept = SweepGarbage();
  if (!swept && !IsObjectRefused(swept.error())) return swept;
  return {};
}

// As in a folder: the objects first, then who lives, then the rows.
Result<void> BlobStore::RemoveBucketLeftovers() {
  std::set<std::string> objects;
  const auto note = [&](const std::string& name, std::uint64_t) {
    if (!MakerOf(MakersPart(name)).empty()) objects.insert(name);
  };
  for (const std::string_view prefix : {kBlobs, kPieces}) {
    if (auto done = bucket_.place->List(std::string(prefix), note); !done) return done;
  }
  const auto living = membership_.Living();
  if (!living) return Forward(living);
  const std::set<std::string, std::less<>> alive(living->begin(), living->end());
  std::erase_if(objects, [&](const std::string& name) {  //
    return alive.contains(MakerOf(MakersPart(name)));
  });
  if (!objects.empty()) {
    auto rows = database_.Read().Query("SELECT hash, file FROM blobs", [&](const Row& row) {
      objects.erase(ObjectOf(row.Text(0), row.Text(1)));
    });
    if (!rows) return Forward(rows);
    rows = database_.Read().Query("SELECT name FROM upload_pieces",
                                  [&](const Row& row) { objects.erase(row.Text(0)); });
    if (!rows) return Forward(rows);
  }
  Result<void> result;
  for (const std::string& name : objects) {
    auto deleted = bucket_.place->Delete(name);
    if (!deleted && !IsObjectRefused(deleted.error())) return deleted;
    if (!deleted && result) result = deleted;
    if (deleted) ++recovery_.orphan_files;
  }
  if (auto aborted = AbortUnfinished(alive); !aborted) return aborted;
  return result;
}

// Whoever is dead can complete nothing that a row would name.
Result<void> BlobStore::AbortUnfinished(const std::set<std::string, std::less<>>& alive) {
  const auto unfinished = bucket_.place->Unfinished();
  if (!unfinished) return Forward(unfinished);
  for (const UnfinishedPut& put : *unfinished) {
    if (!put.name.starts_with(kBlobs) && !put.name.starts_with(kPieces)) continue;
    const std::string_view maker = MakerOf(MakersPart(put.name));
    if (shared_ && (maker.empty() || alive.contains(maker))) continue;
    if (auto aborted = bucket_.place->Abort(put); !aborted) return aborted;
  }
  return {};
}

void BlobStore::Undo(const std::string& object) {
  const Meanwhile whoever_waits({});
  if (bucket_.place->Delete(object)) return;
  auto session = database_.WriteRows();  // SweepGarbage tries again.
  if (session && Doom(*session, object)) (void)session->Commit();
}

Result<BlobPin> BlobStore::AdoptInBucket(const Adoption& file, DiskShare& share) {
  BlobPin pin;  // From now on this process does not collect it.
  {
    const std::lock_guard lock(mutex_);
    pin = PinLocked(file.hash, file.size);
  }
  const auto known = Find(file.hash);
  if (!known) return Forward(known);
  if (*known) {
    const auto there = bucket_.place->Find(ObjectOf(file.hash, (*known)->file));
    if (!there && !IsObjectRefused(there.error())) return Forward(there);
    // Instead of one that is not to be had, or is another, a new one is put.
    const bool sound = there && *there == file.size;
    const auto touched = sound ? Touch(file.hash, 0) : Result<bool>(false);
    if (!touched) return Forward(touched);
    if (*touched) {
      bucket_.cache->Keep(file.folder, file.name, file.hash, file.size);
      return pin;
    }
  }
  const Fd fd(openat(file.folder.get(), file.name.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!fd) return FailSystem(file.name, "cannot be opened", errno);
  const std::string suffix = membership_.NewName(), object = ObjectOf(file.hash, suffix);
  const std::string damaged = *known ? (*known)->file : std::string();
  if (auto put = bucket_.place->Put(object, fd.get(), 0, file.size); !put) {
    Undo(object);  // It may have come about, and the answer not.
    return Forward(put);
  }
  bool certain = true;
  const auto kept = InsertShared(file, suffix, damaged, certain);
  // The row may be there nevertheless: then the object stays until this process is gone.
  if (!kept && certain) Undo(object);
  if (!kept) return Forward(kept);
  if (*kept == suffix) {
    share = DiskShare();
    budget(file.kind).Add(file.size);
  } else {
    // Somebody else stored the same meanwhile; no row will ever name this object.
    Undo(object);
  }
  bucket_.cache->Keep(file.folder, file.name, file.hash, file.size);
  return pin;
}

Result<BlobReader> BlobStore::OpenInBucket(const std::string& hash, bool as_file) {
  auto pinned = PinEntry(hash);
  if (!pinned) return Forward(pinned);
  BlobReader reader;
  reader.pin = std::move(pinned->first);
  const std::string object = ObjectOf(hash, pinned->second);
  const std::uint64_t size = reader.size();
  if (auto copy = bucket_.cache->Find(hash)) {
    reader.fd = std::move(copy->fd);
    reader.lease = std::move(copy->lease);
    return reader;
  }
  if (as_file) {
    auto copy = bucket_.cache->Get(hash, size, [&](int fd) -> Result<void> {
      auto fetched = bucket_.place->Fetch(object, fd, size);
      const bool larger = !fetched && fetched.error().code == ErrorCode::kOverBudget;
      if (larger) return Fail(ErrorCode::kCorruptInput, fetched.error().message);
      return fetched;
    });
    if (!copy && copy.error().code == ErrorCode::kCorruptInput) {
      return FailObjectRefused(bucket_.place->Shown(object) + ": damaged: " + copy.error().message);
    }
    if (!copy) return Forward(copy);
    reader.fd = std::move(copy->fd);
    reader.lease = std::move(copy->lease);
    return reader;
  }
  const auto there = bucket_.place->Find(object);
  if (!there) return Forward(there);
  if (*there != size) {
    return FailObjectRefused(bucket_.place->Shown(object) + ": damaged: " +
                             (*there ? std::to_string(**there) + " bytes" : "nothing") +
                             " found, expected " + std::to_string(size) + " bytes");
  }
  // A reading may take longer than the grace of what nothing refers to.
  auto touched = std::chrono::steady_clock::now();
  const auto keep = [this, hash, touched]() mutable {
    const auto now = std::chrono::steady_clock::now();
    if (!shared_ || now - touched < grace_ / 4) return;
    touched = now;
    (void)Touch(hash, 0);
  };
  reader.object = std::make_shared<ObjectReader>(
      *bucket_.place, ObjectReader::Object{object, hash, size, {}}, keep);
  return reader;
}

void BlobStore::CollectInBucket(const std::string& hash) {
  static const std::string kDelete = std::string(
                                         "DELETE FROM blobs WHERE hash = ? AND touched <= ?"
                                         " AND ") +
                                     kUnreferenced + " RETURNING size, kind, file";
  std::optional<std::string> file;
  std::uint64_t size = 0;
  BlobKind kind = BlobKind::kModel;
  {
    auto session = database_.WriteRows();
    if (!session) return;
    const auto now = session->Now();
    if (!now) return;
    const auto note = [&](const Row& row) {
      size = static_cast<std::uint64_t>(row.Int(0));
      kind = static_cast<BlobKind>(row.Int(1));
      file = row.Text(2);
    };
    // One process knows all pins; of several, each keeps what it pins by touching it.
    const std::int64_t before = shared_ ? ToMillis(*now - grace_) : INT64_MAX;
    // Foreign keys refuse this if a reference came after all.
    if (!session->Query(kDelete, note, hash, before) || !file) return;
    if (!Doom(*session, ObjectOf(hash, *file)) || !session->Commit()) return;
  }
  budget(kind).Remove(size);
  bucket_.cache->Forget(hash);
}

Result<void> BlobStore::SweepGarbage() {
  if (!bucket_) return {};
  std::vector<std::string> names;
  // Drawn, so that those that are refused do not keep out the others.
  auto listed = database_.Read().Query("SELECT name FROM blob_garbage ORDER BY random() LIMIT 1000",
                                       [&](const Row& row) { names.push_back(row.Text(0)); });
  if (!listed) return Forward(listed);
  Result<void> result;
  int refused = 0;
  for (const std::string& name : names) {
    auto deleted = bucket_.place->Delete(name);
    if (!deleted && !IsObjectRefused(deleted.error())) return deleted;
    if (!deleted && result) result = deleted;
    // Others need not wait for it; where keys may delete nothing, few requests are enough.
    if (!deleted && ++refused == kMostRefused) break;
    if (!deleted) continue;
    auto done = database_.Read().Run("DELETE FROM blob_garbage WHERE name = ?", name);
    if (!done) return Forward(done);
  }
  return result;
}

}  // namespace strata::server
