// What needs a data folder: models, jobs, cached results. In plain types, as Service.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "server/service/job_checkpoints.h"
#include "server/service/service.h"
#include "server/store/store.h"
#include "strata/v1/jobs.pb.h"
#include "strata/v1/models.pb.h"

namespace strata::server {

/// Threads: any.
class StoredService {
 public:
  /// Opens the folder and starts as many runners as jobs may run at a time. `service` must outlive
  /// it. Leases are options.jobs.lease. Errors: those of Store::Open.
  static Result<std::unique_ptr<StoredService>> Start(const StoreOptions& options,
                                                      Service& service);
  /// Puts running jobs back into the queue, for the next process.
  ~StoredService();

  Store& store() { return *store_; }
  /// Refuses: kUnavailable when the database is away, or a newer Strata has migrated it.
  Answer<void> CheckReady();
  /// Runners begin no further job; those that run go on.
  void StopClaiming();
  /// Jobs of the queue that run here.
  std::uint32_t running() const { return running_; }

  // --- Models ---

  /// `body` is called with a sink and returns once everything was given to it.
  using Body = std::function<Answer<void>(const std::function<Answer<void>(std::string_view)>&)>;
  struct Put {
    v1::Model model;
    bool created = false;  ///< The name was free.
  };
  /// Refuses: what ModelStore::Put, BlobStore::NewBlob and the body refuse. `size` may be unknown.
  Answer<Put> PutModel(const v1::PutModelHeader& header, std::optional<std::uint64_t> size,
                       const Body& body);
  Answer<v1::Model> GetModel(const std::string& name);
  Answer<v1::ListModelsResponse> ListModels(const v1::ListModelsRequest& request);
  /// `if_sha256`: only if the model has these bytes; empty: whatever it has.
  Answer<void> DeleteModel(const std::string& name, const std::string& if_sha256);
  Answer<Content> OpenModelContent(const std::string& name);

  // --- Results ---

  /// The result for a stored model: at once if it is at hand, else sampled, once for all who ask at
  /// the same time.
  Answer<Sampled> SampleModel(const v1::SampleOptions& options, const std::string& model,
                              const JobWatch& watch);

  // --- Jobs ---

  struct CreatedJob {
    v1::Job job;
    bool created = false;  ///< False: the idempotency key named it.
  };
  Answer<CreatedJob> CreateJob(const v1::CreateJobRequest& request, const std::string& client);
  Answer<v1::Job> GetJob(const std::string& id);
  Answer<v1::ListJobsResponse> ListJobs(const v1::ListJobsRequest& request);
  Answer<v1::Job> CancelJob(const std::string& id);
  /// The job once it has ended, or as it is after `timeout` or when `gone`.
  Answer<v1::Job> WaitJob(const std::string& id, std::chrono::milliseconds timeout,
                          const std::function<bool()>& gone);
  /// Calls `tell` with each change until the job has ended, `tell` says false, or `gone`. `idle` is
  /// called about 20 times a second.
  Answer<void> WatchJob(const v1::WatchJobRequest& request,
                        const std::function<bool(const v1::JobEvent&)>& tell,
                        const std::function<bool()>& gone);
  /// Refuses: conflict for a job that has not succeeded.
  Answer<Sampled> OpenResult(const std::string& id);

 private:
  StoredService(const StoreOptions& options, Service& service);
  /// One content of a model.
  struct Version {
    std::string name, hash;
  };
  Answer<Sampled> SampleVersion(const v1::SampleOptions& options, const Version& model,
                                const JobWatch& watch);
  Answer<Sampled> Lead(const v1::SampleOptions& options, const Version& version,
                       const JobWatch& watch, ResultLead lead);
  Result<BlobPin> KeepResult(const Content& content, const JobWatch& watch);
  void RunJobs();
  void RunClaimed(const JobStore::Claimed& claimed);
  Answer<Sampled> RunAttempt(const Job& job, const JobWatch& watch);
  /// What became of a claimed job while it ran.
  struct Fate {
    bool cancelled = false;  ///< Its client's wish.
    bool lost = false;       ///< Somebody else's by now, or its lease has run out.
    std::chrono::steady_clock::time_point lease_end;  ///< No later than the database sees it.
  };
  void Beat(const JobClaim& claim, const v1::Progress& latest, Fate& fate);
  void EndClaimed(const JobClaim& claim, const Answer<Sampled>& outcome, const Fate& fate);
  Result<void> EndOnce(const JobClaim& claim, const Answer<Sampled>& outcome, const Fate& fate);
  void Maintain();
  void TendBucket();

  Service& service_;
  SystemClock clock_;
  std::unique_ptr<Store> store_;
  /// Null in a shared store: a paused process may still have what its successor would go on from.
  std::unique_ptr<JobCheckpoints> checkpoints_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<bool> stopping_{false}, claiming_{true};
  std::atomic<std::uint32_t> running_{0};
  const std::string owner_;
  const std::chrono::milliseconds lease_;
  bool away_ = false;  // Of the maintaining thread: the log has been told.
  std::vector<std::thread> threads_;
};

}  // namespace strata::server
