// Batches over the mounted repository, as jobs of the service.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "core/result.h"
#include "io/fd.h"
#include "server/service/service.h"
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
  std::chrono::hours retention{168};  ///< Of batches that ended, with their outputs.
};

/// One batch is a child process `strata batch` in a folder of its own, ID/: `batch.json` says what
/// was asked for and how it stands, `out/` is its OUT, `log` what it said. Its manifest is the
/// truth. One runs at a time, and takes its place and memory among the service's jobs. Threads:
/// any.
class BatchService {
 public:
  /// Takes over what a former process left: a batch that ran then is queued again, and goes on
  /// where it was. `service` must outlive it. Errors: kConflict when another process has the
  /// folder; kIo.
  static Result<std::unique_ptr<BatchService>> Start(const BatchServiceOptions& options,
                                                     Service& service);
  /// Ends the one that runs; the next process goes on with it.
  ~BatchService();

  Answer<v1::Batch> Create(const v1::CreateBatchRequest& request);
  Answer<v1::Batch> Get(const std::string& id) const;
  Answer<v1::ListBatchesResponse> List(const v1::ListBatchesRequest& request) const;
  Answer<v1::Batch> Cancel(const std::string& id);
  /// Calls `tell` with the batch now and whenever it has changed, until it has ended, `tell` says
  /// false, or `gone`, which is asked about 20 times a second.
  Answer<void> Watch(const std::string& id, const std::function<bool(const v1::Batch&)>& tell,
                     const std::function<bool()>& gone) const;
  Answer<Content> OpenManifest(const std::string& id) const;
  /// Refuses: not-found for what is no output of the batch.
  Answer<Content> OpenOutput(const std::string& id, const std::string& path) const;

 private:
  struct Entry {
    v1::Batch batch;
    std::uint64_t revision = 1;
    bool cancel = false;
  };
  BatchService(const BatchServiceOptions& options, Service& service)
      : options_(options), service_(service) {}
  Result<void> Load();
  Result<void> Save(const v1::Batch& batch) const;
  void RunQueued();
  void Run(const std::string& id);
  int RunChild(const std::string& id, const v1::CreateBatchRequest& request);
  void ReadProgress(const std::string& id);
  void End(const std::string& id, int status);
  void RemoveOld();
  std::string NextQueued() const;
  bool Unwanted(const std::string& id) const;
  void Change(const std::string& id, const std::function<void(v1::Batch&)>& change);
  std::string PathOf(const std::string& id) const { return options_.folder + '/' + id; }

  const BatchServiceOptions options_;
  Service& service_;
  io::Fd lock_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::map<std::string, Entry> entries_;
  bool stopping_ = false;
  std::thread runner_;
};

}  // namespace strata::server
