// All that a service keeps, opened together.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "core/result.h"
#include "server/store/blob_cache.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/data_folder.h"
#include "server/store/database.h"
#include "server/store/database_clock.h"
#include "server/store/job_store.h"
#include "server/store/membership.h"
#include "server/store/model_repository.h"
#include "server/store/model_store.h"
#include "server/store/object_place.h"
#include "server/store/postgres.h"
#include "server/store/result_cache.h"
#include "server/store/upload_store.h"

namespace strata::server {

/// A database that several processes share.
struct SharedOptions {
  PostgresOptions postgres;
  /// A process that has not renewed it for so long is dead to the others.
  Milliseconds lease = std::chrono::seconds(30);
};

struct StoreOptions {
  std::string data;  ///< --data DIR: made if it is missing.
  /// --blobs: opens the bucket that content lies in, for the process that has the given data
  /// folder. Each of several processes then has a data folder of its own. Empty: content lies in
  /// `data`.
  std::function<Result<std::unique_ptr<ObjectPlace>>(const std::string& data)> bucket;
  std::optional<SharedOptions>
      shared;          ///< Absent: SQLite in `data`, which is this process's alone.
  std::string models;  ///< --models DIR: read-only; "" for none.
  BlobLimits blobs;
  UploadLimits uploads;
  JobLimits jobs;
  /// Finished jobs are forgotten after that time.
  Milliseconds job_retention = std::chrono::hours(24 * 7);
};

/// The stores of one data folder, this process's alone or shared. Threads: any. Nothing that came
/// from it may outlive it: pins, readers, writers, appends, leads.
class Store {
 public:
  /// Opens or makes the folder, brings the database up to date and mends what a crash left; jobs
  /// that were running are queued again. Takes as long as reading complete uploads that were not
  /// yet stored. `clock` must outlive the store; a shared one goes by its database's. Errors:
  /// kConflict when another process has the folder; kUnsupported when a newer Strata wrote it;
  /// kNotFound (the models' folder); kCorruptInput (the database), kIo; IsDatabaseAway.
  static Result<std::unique_ptr<Store>> Open(const StoreOptions& options, const Clock& clock);

  DataFolder& folder() { return *folder_; }
  Database& database() { return *database_; }
  BlobStore& blobs() { return *blobs_; }
  ModelStore& models() { return *models_; }
  UploadStore& uploads() { return *uploads_; }
  JobStore& jobs() { return *jobs_; }
  ResultCache& results() { return *results_; }

  /// Whether the database answers and is one that this program may use, and the bucket answers, if
  /// there is one. Errors: kUnsupported after a newer Strata migrated it, kIo (IsStoreAway).
  Result<void> Check();
  Result<void> CheckDatabase();
  /// Whether the bucket is known not to answer: what needs content would fail.
  bool bucket_is_away() const { return place_ && place_->away(); }

  /// What time brings: expired uploads and old jobs go, jobs whose lease has run out are queued
  /// again, what a full disk kept from being collected is collected. To be called every few
  /// seconds. Errors: kIo; the rest is done all the same.
  Result<void> Maintain();
  /// The same of what waits for the bucket, and may wait for long: expired and whole uploads, what
  /// is to be deleted, leftovers of the dead. Nothing without a bucket. To be called every few
  /// seconds, by another thread than Maintain, which renews this process's lease. Errors:
  /// IsStoreAway.
  Result<void> TendBucket();

 private:
  Store(const StoreOptions& options, const Clock& clock) : options_(options), clock_(&clock) {}
  Result<void> OpenFiles();
  Result<void> OpenShared();
  Result<void> OpenDatabase();
  Result<void> OpenBucket();
  void Listen();
  Result<void> MaintainShared();
  Result<void> OpenStores();

  StoreOptions options_;
  const Clock* clock_;
  // In the order of their use: each goes before what it uses.
  std::unique_ptr<DataFolder> folder_;
  std::unique_ptr<Database> database_;
  std::unique_ptr<DatabaseClock> database_clock_;  // Of a shared store: then clock_ is this.
  std::unique_ptr<Membership> membership_;
  std::unique_ptr<ObjectPlace> place_;
  std::unique_ptr<BlobCache> cache_;
  std::unique_ptr<BlobStore> blobs_;
  std::unique_ptr<ModelRepository> repository_;
  std::unique_ptr<ModelStore> models_;
  std::unique_ptr<UploadStore> uploads_;
  std::unique_ptr<JobStore> jobs_;
  std::unique_ptr<ResultCache> results_;
  std::unique_ptr<Listener> listener_;  // The first to end: it calls the others.
  std::chrono::steady_clock::time_point swept_;
  std::atomic<bool> sweep_is_due_{false};  // Of the bucket.
};

}  // namespace strata::server
