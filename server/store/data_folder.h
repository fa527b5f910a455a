// The folder that a service keeps its state in (--data DIR): of one process, or shared by several.
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "server/store/file.h"

namespace strata::server {

/// What lies in it:
///
///     lock        flock'ed by the process that owns the folder; shared, by those that share it
///     store-id    of a shared folder: which database it belongs to
///     strata.db   SQLite, with its -wal and -shm
///     blobs/ab/…  files named by the SHA-256 of their content: 2 digits, then 62
///     incoming/   files being written; emptied at the start
///     uploads/ID  the bytes of unfinished resumable uploads
///     cache/HASH  with a bucket: copies of what lies in it; there is nothing in blobs/ then
///
/// In a shared folder a file's name tells who made it (Membership::NewName): blobs/ab/….NAME,
/// incoming/NAME, uploads/NAME. There is no strata.db.
///
/// Threads: any; nothing changes after Open.
class DataFolder {
 public:
  /// Makes what is missing (mode 0700), takes the lock, empties incoming/.
  /// Errors: kConflict when a living process has the lock; kIo.
  static Result<std::unique_ptr<DataFolder>> Open(const std::string& path);
  /// The same for the folder of the shared store `id`, which other processes use as well; nothing
  /// is emptied. `known`: the database has such a folder already, so one without its id is another.
  /// Errors: kConflict for the folder of another store, or of a process that keeps SQLite in it.
  static Result<std::unique_ptr<DataFolder>> OpenShared(const std::string& path,
                                                        const std::string& id, bool known);

  /// The folder of one of the processes that share a database and a bucket: its own alone, for
  /// drafts and copies. Errors: kConflict when a living process has the lock, or where a store
  /// lies.
  static Result<std::unique_ptr<DataFolder>> OpenOwn(const std::string& path);

  const std::string& path() const { return path_; }
  std::string database_path() const { return path_ + "/strata.db"; }
  /// Where a program that writes a file by name (a sampling process) may put it; see
  /// BlobStore::Import.
  std::string incoming_path() const { return path_ + "/incoming"; }
  /// Makes and opens cache/.
  Result<Fd> OpenCache() const { return OpenFolder(root_.get(), "cache"); }
  const Fd& root() const { return root_; }
  const Fd& blobs() const { return blobs_; }
  const Fd& incoming() const { return incoming_; }
  const Fd& uploads() const { return uploads_; }

 private:
  DataFolder() = default;
  Result<void> Lock(int operation);
  Result<void> Begin(const std::string& path, int lock_operation);
  Result<void> Claim(const std::string& id, bool known);
  Result<void> OpenInner();
  Result<void> Empty(const Fd& inner) const;

  std::string path_;
  Fd root_, lock_, blobs_, incoming_, uploads_;
};

}  // namespace strata::server
