// Batches over the mounted repository, as jobs of the service.
#pragma once

#include <google/protobuf/timestamp.pb.h>

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/result.h"
#include "io/fd.h"
#include "server/service/service.h"
#include "server/store/batch_rows.h"
#include "server/store/store.h"
#include "strata/v1/batches.pb.h"

namespace strata::server {

/// How a service runs batches.
struct BatchServiceOptions {
  std::string folder;              ///< Where they are kept: one folder each. Made if it is missing.
  std::string models;              ///< The repository.
  std::uint64_t memory_bytes = 0;  ///< Of one batch; at least kLeastBatchMemory.
  std::uint32_t jobs = 1;          ///< Models at a time.
  std::uint32_t timeout_seconds = 600;  ///< Of one model.
  std::uint64_t most_queued = 1000;
  std::chrono::hours retention{168};        ///< Of batches that ended, with their outputs.
  std::chrono::milliseconds lease{30'000};  ///< Of a process, where several share a store.
  std::int64_t most_attempts = 3;  ///< A batch that was begun so often and never ended has failed.
  /// Where several processes share a bucket: "s3://BUCKET/PREFIX/batches", where outputs go instead
  /// of to the folder; the environment that holds its keys, and whether plain http will do.
  std::string bucket;
  std::vector<std::string> bucket_environment;
  bool s3_insecure = false;
};

/// One batch is a child process `strata batch` in a folder of its own, ID/: `batch.json` says what
/// was asked for and how it stands, `out/` is its OUT, `log` what it said. Its manifest is the
/// truth. One runs at a time, and takes its place and memory among the service's jobs.
///
/// Where several processes share a store, rows of it (BatchRows) stand for `batch.json`: each shows
/// all, any may cancel, and each runs one at a time. One whose process died, or gave it back, is
/// taken up by another: from the manifest, since `out/` lies in a folder that they share, or in the
/// bucket, where `out/` is but the folder of state. Threads: any.
class BatchService {
 public:
  /// Takes over what a former process left: a batch that ran then is queued again, and goes on
  /// where it was. `service`, and `store`, if it is shared, must outlive it. Errors: kConflict when
  /// another process has the folder; kIo.
  static Result<std::unique_ptr<BatchService>> Start(const BatchServiceOptions& options,
                                                     Service& service, Store& store);
  /// Ends the one that runs; the next process goes on with it.
  ~BatchService();

  Answer<v1::Batch> Create(const v1::CreateBatchRequest& request);
  Answer<v1::Batch> Get(const std::string& id);
  Answer<v1::ListBatchesResponse> List(const v1::ListBatchesRequest& request);
  Answer<v1::Batch> Cancel(const std::string& id);
  /// Calls `tell` with the batch now and whenever it has changed, until it has ended, `tell` says
  /// false, or `gone`, which is asked about 20 times a second.
  Answer<void> Watch(const std::string& id, const std::function<bool(const v1::Batch&)>& tell,
                     const std::function<bool()>& gone);
  /// Of one that runs elsewhere into a bucket: as it was last saved there, at most 30 s ago.
  Answer<Content> OpenManifest(const std::string& id);
  /// Refuses: not-found for what is no output of the batch.
  Answer<Content> OpenOutput(const std::string& id, const std::string& path);

 private:
  struct Entry {
    v1::Batch batch;
    std::uint64_t revision = 1;
    bool cancel = false;
    std::optional<BatchRow> claimed;  ///< Of a shared store: it runs here.
    bool lost = false;                ///< Another process has it by now.
  };
  BatchService(const BatchServiceOptions& options, Service& service, Store& store);
  static google::protobuf::Timestamp Now();  ///< In whole milliseconds.
  Result<void> Own();
  Result<void> Load();
  Result<void> Save(const v1::Batch& batch);
  void RunQueued();
  void Run(const std::string& id);
  int RunChild(const std::string& id, const v1::CreateBatchRequest& request);
  void ReadProgress(const std::string& id);
  void End(const std::string& id, int status);
  void RemoveOld();
  std::string NextQueued();
  bool Unwanted(const std::string& id) const;
  void Change(const std::string& id, const std::function<void(v1::Batch&)>& change);
  // Of a shared store (batch_sharing.cc).
  Answer<void> Refresh(const std::string& id);
  void Show(const BatchRow& row);
  void Lose(const std::string& id);
  bool GiveUpLost(const std::string& id);
  void Close(const v1::Batch& ended);
  Answer<v1::ListBatchesResponse> ListShared(std::size_t size, const std::string& after);
  std::string Claim();
  Result<void> SaveShared(const v1::Batch& batch);
  void RemoveOldShared();
  Result<void> RemoveOutputs(const std::string& id);
  void RemoveStrangers();
  Answer<Content> OpenObject(const std::string& id, const std::string& path,
                             const std::string& media_type);
  std::string PathOf(const std::string& id) const { return options_.folder + '/' + id; }
  /// OUT of `strata batch`, or its folder of state.
  std::string OutOf(const std::string& id) const { return PathOf(id) + "/out"; }
  bool InBucket() const { return rows_ && !options_.bucket.empty(); }
  bool RunsHere(const std::string& id) const {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    return found != entries_.end() && found->second.claimed;
  }

  const BatchServiceOptions options_;
  Service& service_;
  Store& store_;
  const std::unique_ptr<BatchRows> rows_;  // Null: this process's alone.
  io::Fd lock_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::map<std::string, Entry> entries_;
  bool stopping_ = false;
  std::chrono::steady_clock::time_point strangers_removed_;
  std::thread runner_;
};

}  // namespace strata::server
