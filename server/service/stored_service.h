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
  /// it. Errors: those of Store::Open.
  static Result<std::unique_ptr<StoredService>> Start(const StoreOptions& options,
                                                      Service& service);
  /// Puts running jobs back into the queue, for the next process.
  ~StoredService();

  Store& store() { return *store_; }

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
  explicit StoredService(Service& service) : service_(service) {}
  Answer<Sampled> SampleOpened(const v1::SampleOptions& options, const OpenModel& model,
                               const JobWatch& watch);
  Answer<Sampled> Lead(const v1::SampleOptions& options, const OpenModel& model,
                       const JobWatch& watch, ResultLead lead);
  void RunJobs();
  void RunClaimed(const JobStore::Claimed& claimed);
  Answer<Sampled> RunAttempt(const Job& job, const JobWatch& watch);
  void EndClaimed(const JobClaim& claim, const Answer<Sampled>& outcome, bool cancelled, bool lost);
  void Maintain();

  Service& service_;
  SystemClock clock_;
  std::unique_ptr<Store> store_;
  std::unique_ptr<JobCheckpoints> checkpoints_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::atomic<bool> stopping_{false};
  std::vector<std::thread> threads_;
};

}  // namespace strata::server
