// Resumable uploads: the state behind tus 1.0 (core, creation, expiration, checksum, termination),
// without HTTP.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "core/result.h"
#include "io/sha256.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/model_store.h"

namespace strata::server {

struct UploadLimits {
  std::uint64_t max_bytes = std::uint64_t{16} << 30;   ///< Of one upload.
  std::size_t max_open = 1000;                         ///< Unfinished uploads at a time.
  Milliseconds time_to_live = std::chrono::hours(24);  ///< After the last byte.
  /// What a crash may cost at most: that many bytes come, then they are made durable.
  std::uint64_t sync_bytes = std::uint64_t{32} << 20;
};

struct NewUpload {
  std::string model;                    ///< What the finished upload is stored as.
  std::optional<std::uint64_t> length;  ///< Absent: deferred, told later by SetLength.
  std::string metadata;                 ///< The client's own, given back as it came; up to 4 KiB.
};

struct UploadInfo {
  std::string id;
  std::string model;
  std::string metadata;
  std::optional<std::uint64_t> length;
  std::uint64_t offset = 0;  ///< Bytes that are durable; also after a crash.
  Timestamp created;
  Timestamp expires;
  /// SHA-256 of the finished upload, which is a model now; "" while bytes are missing.
  std::string hash;
  /// In a shared store: the name of its file, and which process appends to it; "" otherwise.
  std::string file, holder;
};

/// What one request's bytes must hash to.
struct UploadChecksum {
  io::DigestKind kind = io::DigestKind::kSha1;
  std::string hex;  ///< Lower case.
};

class UploadStore;
class UploadPieces;

/// One request's bytes on their way into an upload. Destroyed without Finish it keeps what came,
/// unless a checksum was announced, which nothing has then fulfilled.
/// Threads: one at a time.
class UploadAppend {
 public:
  UploadAppend(UploadAppend&&) noexcept;
  ~UploadAppend();

  /// Errors: kInvalidArgument beyond the upload's length (nothing of `bytes` is kept); kOverBudget
  /// (a deferred length outgrew a limit); kConflict when another request took over; kIo. After an
  /// error nothing more can be written.
  Result<void> Write(std::string_view bytes);
  /// Makes the bytes durable. With the last of them the upload becomes its model, which takes as
  /// long as reading what came in other requests' bytes before a restart.
  /// Errors: kCorruptInput when the checksum differs (the bytes are discarded); those of
  /// ModelStore::Put; kIo.
  Result<UploadInfo> Finish();

 private:
  friend class UploadStore;
  struct Entry;
  UploadAppend() = default;
  Result<void> CheckRoom(std::uint64_t bytes);
  Result<void> WriteChecked(std::string_view bytes);
  Result<void> MakeDurable();
  Result<void> Verify();
  Result<void> Settle();

  UploadStore* store_ = nullptr;  // Null: finished or moved from.
  std::shared_ptr<Entry> entry_;
  Fd fd_;
  std::optional<UploadChecksum> checksum_;
  io::Hasher checksum_hasher_;
  std::uint64_t begin_ = 0;     // Where this request's bytes begin.
  std::uint64_t position_ = 0;  // Where the next one goes.
  bool failed_ = false;
};

/// The uploads of a data folder. Threads: any; one append at a time to one upload.
///
/// In a shared store an upload may go on in any process. Who appends is its row's `holder`, and
/// every change of the row asks for that: a process that was away for longer than its lease and
/// lost the upload changes nothing any more. What it may still write goes to a file that nobody
/// reads: who takes over from a holder that never let go copies the durable bytes to a file of its
/// own. Where the processes share a bucket and no folder, the durable bytes are objects in it
/// (UploadPieces), and a file here is a copy of some of them.
class UploadStore {
 public:
  struct Parts {
    DataFolder& folder;
    Database& database;
    BlobStore& blobs;
    ModelStore& models;
    const Clock& clock;
  };
  /// Takes up what the last process left: cuts each file back to its durable offset, removes files
  /// that belong to no upload, and turns complete ones into models. Everything outlives the store.
  /// Errors: kIo.
  static Result<std::unique_ptr<UploadStore>> Open(const Parts& parts, const UploadLimits& limits);
  ~UploadStore();

  /// Reserves the disk space of a known length. Length 0 makes an empty model at once.
  /// Errors: kInvalidArgument (name, metadata), kConflict (a read-only name), kOverBudget, kIo.
  Result<UploadInfo> Create(const NewUpload& upload);

  /// Errors: kNotFound for an unknown or expired one.
  Result<UploadInfo> Head(const std::string& id);

  /// Once, for an upload whose length was deferred. Errors: kNotFound, kConflict (another length
  /// was told before), kInvalidArgument (less than what came), kOverBudget, kIo.
  Result<UploadInfo> SetLength(const std::string& id, std::uint64_t length);

  /// Begins to append at `offset`. An append that is under way is told to stop, for its client may
  /// have gone: this call is refused, and the client's next attempt comes through.
  /// Errors: kNotFound, kConflict (`offset` is not the upload's; another append is under way; the
  /// upload is finished), kInvalidArgument (an ill-formed checksum), kIo.
  Result<UploadAppend> Append(const std::string& id, std::uint64_t offset,
                              std::optional<UploadChecksum> checksum = std::nullopt);

  /// Errors: kNotFound, kConflict (an append is under way; it is told to stop), kIo.
  Result<void> Terminate(const std::string& id);

  /// Removes what has expired, finished uploads' records included. Returns how many. Errors: kIo.
  Result<std::size_t> RemoveExpired();

  /// Another process wants to append to an upload: "ID HOLDER", who is to stop.
  void StopAppend(const std::string& text);

 private:
  friend class UploadAppend;
  using Entry = UploadAppend::Entry;
  UploadStore(const Parts& parts, const UploadLimits& limits);

  /// The name of an upload's file in uploads/.
  static const std::string& FileOf(const UploadInfo& info) {
    return info.file.empty() ? info.id : info.file;
  }
  Result<std::size_t> CountOpen();
  DiskShare NewShare() { return parts_.blobs.budget(BlobKind::kModel).NewShare(); }
  // Of a shared store (upload_sharing.cc).
  Result<void> Load(const std::string& id);
  Result<void> Hold(Entry& entry);
  Result<void> TakeOver(Entry& entry, const std::string& former);
  void LetGo(Entry& entry);
  Result<void> LetGoOf(const std::string& id, bool busy);
  Result<std::vector<std::string>> Abandoned(const std::string& condition);
  Result<std::size_t> RemoveExpiredShared();
  Result<void> RemoveUnheld(const std::string& id);
  Result<void> StorePiece(Entry& entry, int fd, std::uint64_t end);
  Result<void> RemoveOldCopies();

  Result<void> Recover();
  Result<void> Resume(const UploadInfo& info);
  Result<void> RemoveStrangers();
  Result<std::shared_ptr<Entry>> Find(const std::string& id);
  Result<std::shared_ptr<Entry>> Occupy(const std::string& id);
  void Leave(Entry& entry);
  Result<Fd> OpenFile(const UploadInfo& info, int more_flags = 0) const;
  Result<void> CheckNew(const NewUpload& upload);
  Result<void> Insert(const UploadInfo& info);
  /// Writes what may change of an upload to the database, then shows it to readers.
  Result<void> Update(Entry& entry, const UploadInfo& info);
  Result<void> StoreOffset(Entry& entry, std::uint64_t offset);
  Result<void> CutBack(const UploadInfo& info) const;
  Result<std::string> HashOf(Entry& entry);
  /// Makes the upload its model if all of its bytes are there.
  Result<void> CompleteIfWhole(Entry& entry);
  Result<void> Remove(Entry& entry);
  Result<UploadInfo> InfoOf(const Entry& entry);
  Timestamp Expiry() const { return parts_.clock.Now() + limits_.time_to_live; }

  Parts parts_;
  UploadLimits limits_;
  const bool shared_;
  const std::unique_ptr<UploadPieces> pieces_;  // Null: the bytes lie in the folder.
  std::mutex mutex_;  // Guards entries_, unreleased_, and each entry's `busy` and `info`.
  std::set<std::string> unreleased_;  // Held, though nobody here is at them: the database was away.
  std::unordered_map<std::string, std::shared_ptr<Entry>> entries_;
};

}  // namespace strata::server
