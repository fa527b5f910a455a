// Results by what they were computed from: a repeated request is answered without sampling again.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/result.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/database.h"

namespace strata::server {

/// What decides a result's bytes (promise 3).
struct ResultKeyParts {
  std::string model_hash;  ///< SHA-256 of the mesh file.
  std::string options;  ///< Canonical: every option that decides the output, its format included.
  std::uint64_t seed = 0;
  std::string version;  ///< Of Strata.
};

/// 64 hex digits: SHA-256 over the parts, none of which can run into another.
std::string ResultKey(const ResultKeyParts& parts);

struct CachedResult {
  BlobReader content;  ///< Not evicted while open. The blob's hash is the strong ETag.
  std::string media_type;
  std::string summary;  ///< Opaque here.
  Timestamp created;
};

/// Somebody else's computation of a result, to be waited for. Threads: any.
class ResultWait {
 public:
  /// Waits up to `timeout` for the end of the computation; whether it has ended. If so and there is
  /// no error(), enter again: the result is there, or whoever led has given up.
  bool Wait(Milliseconds timeout);
  /// Why there will be no result: what the leader said. Set once Wait has returned true.
  std::optional<Error> error() const;

 private:
  friend class ResultCache;
  mutable std::mutex mutex_;
  std::condition_variable ended_came_;
  bool ended_ = false;
  std::optional<Error> error_;
};

class ResultCache;

/// The duty to compute a result, while others wait. Destroyed without an answer it passes to one of
/// those who wait. Threads: one at a time. Must not outlive the cache.
class ResultLead {
 public:
  ResultLead(ResultLead&& other) noexcept;
  ~ResultLead();

  /// Stores the result and wakes who waits. Errors: kIo; they are then told of it as well.
  Result<void> Publish(const BlobPin& blob, const std::string& media_type,
                       const std::string& summary);
  /// Tells who waits that it would fail for them too (a corrupt mesh, say).
  void MarkFailed(const Error& error);

 private:
  friend class ResultCache;
  ResultLead(ResultCache* cache, std::string key) : cache_(cache), key_(std::move(key)) {}
  ResultCache* cache_;  // Null: answered or moved from.
  std::string key_;
};

/// What Enter found: exactly one of the three.
struct CacheAnswer {
  std::optional<CachedResult> hit;
  std::optional<ResultLead> lead;
  std::shared_ptr<ResultWait> wait;
};

struct CacheCounts {
  std::uint64_t hits = 0, misses = 0, waits = 0, evictions = 0;
};

/// The result cache. It takes what disk the budget for results has; when space is wanted the least
/// recently used results go, except for what is open or belongs to a job. In a shared store one
/// process leads a computation and the others wait (table `flights`); a process that dies loses its
/// lead. Threads: any.
class ResultCache {
 public:
  struct Parts {
    Database& database;
    BlobStore& blobs;  ///< Is told to ask this cache for room.
    const Clock& clock;
  };
  static Result<std::unique_ptr<ResultCache>> Open(const Parts& parts);
  ~ResultCache();

  /// The result, if there is one. Errors: kIo.
  Result<std::optional<CachedResult>> Lookup(const std::string& key);
  /// The result; or else the duty to compute it; or else who does. One leads at a time.
  /// Errors: kIo.
  Result<CacheAnswer> Enter(const std::string& key);

  /// Evicts until `bytes` have been given back, as far as that is possible. Whether anything was
  /// evicted. Blobs' own locks are taken: call without them.
  bool Evict(std::uint64_t bytes);
  /// Forgets a result. Errors: kIo.
  Result<void> Remove(const std::string& key);
  /// Writes down what was used when; a crash before makes the order of eviction older, no more.
  Result<void> Flush();

  /// In a shared store: another process's computation of `key` has ended.
  void HearOfFlight(const std::string& key);
  /// Something may have been missed: ends the waits for computations that are no more, here and
  /// elsewhere.
  void Look();
  CacheCounts counts() const { return {hits_, misses_, waits_, evictions_}; }

 private:
  friend class ResultLead;
  struct Candidate {
    std::string key, blob;
    std::uint64_t size;
  };
  /// What a row says of a result.
  struct Known {
    std::string hash, media_type, summary;
    Timestamp created;
  };
  explicit ResultCache(const Parts& parts) : parts_(parts) {}
  Result<std::optional<Known>> FindKnown(const std::string& key);
  Result<std::optional<CachedResult>> OpenKnown(const std::string& key, Known known);
  /// Nothing: another result than `broken` was stored meanwhile.
  Result<std::optional<CacheAnswer>> JoinOrLead(const std::string& key, const std::string& broken);
  Result<void> Store(const std::string& key, const BlobPin& blob, const std::string& media_type,
                     const std::string& summary);
  Result<std::vector<Candidate>> Candidates();
  void EndFlight(const std::string& key, const std::optional<Error>& error);
  void EndWaits(const std::string& key, const std::optional<Error>& error);
  Result<bool> TakeLead(const std::string& key);
  void GiveUpLead(const std::string& key);
  void Touch(const std::string& key);
  std::int64_t NextUse();

  Parts parts_;
  std::atomic<std::uint64_t> hits_{0}, misses_{0}, waits_{0}, evictions_{0};
  std::mutex flights_mutex_;  // Taken before the locks of blobs and database.
  std::unordered_map<std::string, std::shared_ptr<ResultWait>> flights_;
  std::set<std::string> elsewhere_;  // Those of flights_ that another process leads.
  std::set<std::string> unended_;    // Led here once; the database was away when they ended.
  std::mutex uses_mutex_;
  std::int64_t last_use_ = 0;                           // Counts uses: finer than any clock.
  std::unordered_map<std::string, std::int64_t> uses_;  // Not in the database yet.
};

}  // namespace strata::server
