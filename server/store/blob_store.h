// Files named by the SHA-256 of their content: models as uploaded, results as computed. They lie in
// the data folder or in a bucket.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "core/result.h"
#include "io/sha256.h"
#include "server/store/blob_cache.h"
#include "server/store/data_folder.h"
#include "server/store/database.h"
#include "server/store/disk_budget.h"
#include "server/store/membership.h"
#include "server/store/object_place.h"
#include "server/store/object_reader.h"

namespace strata::server {

/// What a blob was first stored as; each kind has its part of the disk.
enum class BlobKind : std::uint8_t { kModel, kResult };

struct BlobLimits {
  std::uint64_t model_bytes = std::uint64_t{64} << 30;   ///< Models and unfinished uploads.
  std::uint64_t result_bytes = std::uint64_t{16} << 30;  ///< Results, cached or of jobs.
  /// What new content leaves free on the disk, so that the database can still be written to.
  std::uint64_t keep_free_bytes = std::uint64_t{64} << 20;
  /// In a shared store: how long a blob that nothing refers to stays after it was last pinned, by
  /// whichever process. Longer than a pin lasts before the database refers to its blob; should one
  /// last longer after all, the reference is refused, not broken.
  Milliseconds grace = std::chrono::minutes(10);
  std::uint64_t cache_bytes = std::uint64_t{16} << 30;  ///< Copies here of what lies in a bucket.
};

class BlobStore;

/// Keeps a blob on disk while it lives, referred to by the database or not. A blob that nothing
/// refers to goes with its last pin.
///
/// Threads: one at a time. Not destroyed while a Session lives in the same thread.
class BlobPin {
 public:
  BlobPin() = default;
  BlobPin(BlobPin&& other) noexcept;
  BlobPin& operator=(BlobPin&& other) noexcept;
  ~BlobPin();

  const std::string& hash() const { return hash_; }
  std::uint64_t size() const { return size_; }

 private:
  friend class BlobStore;
  BlobPin(BlobStore* store, std::string hash, std::uint64_t size)
      : store_(store), hash_(std::move(hash)), size_(size) {}
  void Release();
  BlobStore* store_ = nullptr;
  std::string hash_;
  std::uint64_t size_ = 0;
};

/// A blob open for reading. Threads: ReadAt any number at once.
struct BlobReader {
  BlobPin pin;
  Fd fd;  ///< Of the whole content, read-only; a child process may inherit it. None with `object`.
  std::shared_ptr<const void> lease;     ///< Of the cache's copy that `fd` is of.
  std::shared_ptr<ObjectReader> object;  ///< Of a bucket's blob that no file here holds.

  std::uint64_t size() const { return pin.size(); }
  /// Fills `out` from byte `offset`. Errors: kIo, the end included; IsBucketAway.
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) const {
    if (object) return object->ReadAt(offset, out);
    return ReadFileAt(fd.get(), offset, out, pin.hash());
  }
};

/// Where blobs lie that do not lie in the data folder; both null: they do. Of the store's owner.
struct BlobBucket {
  ObjectPlace* place = nullptr;
  BlobCache* cache = nullptr;

  explicit operator bool() const { return place != nullptr; }
};

/// A blob being written, hashed as it passes. Without Commit nothing stays. Threads: one at a time.
class BlobWriter {
 public:
  BlobWriter(BlobWriter&&) noexcept = default;
  ~BlobWriter();

  /// Appends. Errors: kOverBudget before a byte beyond the limit is written; kInvalidArgument
  /// beyond the size that was announced; kIo (full disk). After an error the writer is spent.
  Result<void> Write(std::string_view bytes);
  /// Makes the blob durable under its name, and pins it until the caller has stored what refers to
  /// it. Errors: kInvalidArgument when fewer bytes came than were announced; kIo.
  Result<BlobPin> Commit();
  std::uint64_t size() const { return size_; }

 private:
  friend class BlobStore;
  BlobWriter() = default;
  Result<void> MakeRoom(std::uint64_t bytes);
  void Discard();

  BlobStore* store_ = nullptr;
  BlobKind kind_ = BlobKind::kModel;
  std::string name_;  // In incoming/.
  Fd fd_;             // Moved from or spent: none.
  io::Hasher hasher_;
  DiskShare share_;
  std::optional<std::uint64_t> announced_;
  std::uint64_t size_ = 0;
};

/// What Open found and mended.
struct BlobRecovery {
  std::uint64_t orphan_files = 0;    ///< Files without a row, removed.
  std::uint64_t unreferenced = 0;    ///< Rows that nothing referred to, removed with their files.
  std::vector<std::string> damaged;  ///< Blobs whose file is missing or of another size: kept.
};

/// The blobs of a data folder.
///
/// Where processes share the folder, each blob's file has a name of its own (Membership::NewName),
/// which its row holds: two that store the same content never touch one file, and a process that
/// was declared dead cannot commit a row any more, so its files without a row are leftovers for
/// certain.
///
/// A blob's file is whole and durable before its row is, and its row is gone before its file: after
/// a crash at any point there is no row without its file, and a file without a row is removed by
/// the next Open.
///
/// In a bucket every object has a name of its own, whichever the database; a blob is put under it
/// before its row is there. What is to be deleted stands in the table `blob_garbage` from the
/// transaction on that deletes its row, and SweepGarbage does it. Nothing here waits for the bucket
/// with a lock held. Files in the data folder are then drafts, and copies in the cache.
///
/// Threads: any. Locks are taken in the order blobs, database, budget.
class BlobStore {
 public:
  /// Removes what no row names and what nothing refers to. `folder` and `database` (migrated) must
  /// outlive it. Errors: kIo, kCorruptInput.
  static Result<std::unique_ptr<BlobStore>> Open(DataFolder& folder, Database& database,
                                                 Membership& membership, const BlobLimits& limits,
                                                 const BlobBucket& bucket = {});

  /// With `size` known, space is reserved at once: kOverBudget comes before anything is written.
  Result<BlobWriter> NewBlob(BlobKind kind, std::optional<std::uint64_t> size = std::nullopt);
  /// Takes the file `name` in incoming/, which another process has finished, as a blob. The file is
  /// gone from incoming/ on return, also on errors. Errors: kNotFound, kOverBudget, kUnsupported
  /// (no regular file), kIo.
  Result<BlobPin> Import(const std::string& name, BlobKind kind);
  struct Adoption {
    const Fd& folder;
    std::string name;  ///< In `folder`.
    std::string hash;  ///< Of its content.
    std::uint64_t size;
    BlobKind kind;
  };
  /// Takes a file whose content is durable as a blob, by a second (hard) link. `share` is what was
  /// reserved for it, at least its size; it is used up if the blob is new. Errors: kIo.
  Result<BlobPin> Adopt(const Adoption& file, DiskShare& share);

  /// Errors: kNotFound; kIo when the file is not there or of another size; IsBucketAway.
  Result<BlobReader> OpenBlob(const std::string& hash);
  /// The same with `fd`: fetched from the bucket if need be, which takes as long. Errors: also
  /// kOverBudget (larger than the cache), kCancelled (Meanwhile).
  Result<BlobReader> OpenBlobFile(const std::string& hash);
  /// Errors: kNotFound.
  Result<BlobPin> Pin(const std::string& hash);
  bool IsPinned(const std::string& hash) const;
  /// Forgets `hash` if nothing refers to it and nothing pins it. To be called after a reference was
  /// deleted. A failure to do so is mended by the next Open.
  void Collect(const std::string& hash);
  /// Collect for every blob: what a failure (a full disk) kept from being collected.
  Result<void> CollectAll();
  /// In a shared store: removes the files that dead processes left and no row names, in all
  /// folders. Reads every folder. Errors: kIo.
  Result<void> RemoveLeftovers();
  /// Deletes from the bucket what is due. Errors: those of the bucket; the rest stays due.
  Result<void> SweepGarbage();
  const BlobBucket& bucket() const { return bucket_; }
  /// Deletes an object that no row will ever name, also when nobody waits for it any more. If the
  /// bucket is away it is due for SweepGarbage; if the database is, too, it is a leftover once this
  /// process is gone.
  void Undo(const std::string& object);
  /// In a shared store: counts anew what is on the disk, for the budgets. Errors: kIo.
  Result<void> CountBytes();
  Membership& membership() { return membership_; }
  Milliseconds grace() const { return grace_; }

  DiskBudget& budget(BlobKind kind) { return kind == BlobKind::kModel ? models_ : results_; }
  /// Grows `share` by `bytes` of `kind`; asks the room maker when there is no room.
  Result<void> Reserve(DiskShare& share, BlobKind kind, std::uint64_t bytes);
  /// The same in steps of at least 1 MiB where the budget has that much: for bytes that come little
  /// by little, their number unknown.
  Result<void> ReserveStep(DiskShare& share, BlobKind kind, std::uint64_t bytes);
  /// `make_room` is asked for bytes of results: it evicts, and says whether it did anything. Called
  /// without locks. Set once, before the store is shared.
  void SetRoomMaker(std::function<bool(std::uint64_t bytes)> make_room) {
    make_room_ = std::move(make_room);
  }
  const BlobRecovery& recovery() const { return recovery_; }
  /// The blob's path within the data folder, for messages and tests.
  static std::string PathOf(const std::string& hash) {
    return "blobs/" + hash.substr(0, 2) + "/" + hash.substr(2);
  }

 private:
  friend class BlobPin;
  friend class BlobWriter;
  BlobStore(DataFolder& folder, Database& database, Membership& membership,
            const BlobLimits& limits, const BlobBucket& bucket)
      : folder_(folder),
        database_(database),
        membership_(membership),
        bucket_(bucket),
        shared_(database.shared()),
        grace_(limits.grace),
        keep_free_bytes_(limits.keep_free_bytes),
        models_("models", limits.model_bytes),
        results_("results", limits.result_bytes) {}

  Result<void> Recover();
  Result<void> SweepFolder(const std::string& prefix, const std::set<std::string>& known);
  /// What a row says of its blob.
  struct Entry {
    std::uint64_t size = 0;
    std::string file;  ///< What its file's name ends with in a shared store; "" otherwise.
    std::int64_t touched = 0;
  };
  Result<std::optional<Entry>> Find(const std::string& hash);
  bool HasFile(const std::string& hash, const Entry& entry) const;
  static std::string FileOf(const std::string& hash, const std::string& suffix);
  Result<BlobPin> AdoptShared(const Adoption& file, DiskShare& share);
  // In a bucket (blob_bucket.cc).
  Result<void> RecoverBucket();
  Result<void> RemoveBucketLeftovers();
  Result<void> AbortUnfinished(const std::set<std::string, std::less<>>& alive);
  Result<BlobPin> AdoptInBucket(const Adoption& file, DiskShare& share);
  Result<BlobReader> OpenInBucket(const std::string& hash, bool as_file);
  void CollectInBucket(const std::string& hash);
  static std::string ObjectOf(const std::string& hash, const std::string& suffix);
  Result<std::string> InsertShared(const Adoption& file, const std::string& suffix,
                                   const std::string& damaged, bool& certain);
  Result<bool> Touch(const std::string& hash, std::int64_t touched);
  void CollectShared(const std::string& hash);
  Result<void> CheckFreeSpace(std::uint64_t bytes) const;
  Result<void> Link(const Adoption& file, const std::string& suffix);
  Result<void> Insert(const Adoption& file, DiskShare& share);
  Result<std::pair<BlobPin, std::string>> PinEntry(const std::string& hash);
  BlobPin PinLocked(const std::string& hash, std::uint64_t size);
  void Unpin(const std::string& hash);
  void CollectLocked(const std::string& hash);

  DataFolder& folder_;
  Database& database_;
  Membership& membership_;
  const BlobBucket bucket_;
  const bool shared_;
  const Milliseconds grace_;
  std::uint64_t keep_free_bytes_;
  DiskBudget models_, results_;
  std::function<bool(std::uint64_t)> make_room_;
  BlobRecovery recovery_;
  mutable std::mutex mutex_;  // Guards pins_, and the order of files and rows.
  std::unordered_map<std::string, std::uint64_t> pins_;
};

}  // namespace strata::server
