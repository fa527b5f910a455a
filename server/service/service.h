// The application: what the service does, in plain types. HTTP and gRPC translate to it and back.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "core/scratch.h"
#include "server/service/admission.h"
#include "server/service/api_keys.h"
#include "server/service/job.h"
#include "server/service/metrics.h"
#include "server/service/problem.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// What bounds the service's work. Bytes and seconds.
struct ServiceLimits {
  std::uint64_t body_bytes = 0;        ///< Of one request.
  std::uint32_t requests = 0;          ///< In flight at a time, both protocols together.
  Admission::Limits jobs;              ///< All jobs together.
  std::uint64_t job_memory_bytes = 0;  ///< One job.
  std::uint32_t job_threads = 0;       ///< One job, at least 1.
  std::uint32_t job_seconds = 0;       ///< One job, waiting excluded.
  std::uint64_t result_bytes = 0;      ///< Of one job.
  bool isolate = true;                 ///< Each job in a child process.
};

/// A place among the requests in flight, given back when it goes.
class RequestSlot {
 public:
  explicit RequestSlot(std::atomic<std::uint32_t>& count) : count_(&count) {}
  RequestSlot(RequestSlot&& other) noexcept : count_(std::exchange(other.count_, nullptr)) {}
  RequestSlot& operator=(RequestSlot&&) = delete;
  ~RequestSlot() {
    if (count_) count_->fetch_sub(1);
  }

 private:
  std::atomic<std::uint32_t>* count_;
};

/// A mesh on its way in: to an unnamed file on disk, never held whole. Threads: one at a time.
class Upload {
 public:
  Upload(std::unique_ptr<ScratchFile> file, std::uint64_t limit)
      : file_(std::move(file)), limit_(limit) {}

  /// Refuses: kBodyTooLarge; storage when the disk is full.
  Answer<void> Append(std::string_view bytes);
  const ScratchFile& file() const { return *file_; }

 private:
  std::unique_ptr<ScratchFile> file_;
  std::uint64_t limit_;
};

/// Bytes to be sent: open, whole, and there as long as this is. Copies read the same.
struct Content {
  /// Fills `out` from byte `offset`. Errors: kIo.
  std::function<Result<void>(std::uint64_t offset, std::span<char> out)> read;
  std::uint64_t size = 0;
  std::string media_type;
  std::string etag;  ///< Strong, with its quotes; empty: none.
};

/// A result, whole.
struct Sampled {
  Content content;
  v1::SampleSummary summary;
};

class StoredService;
class BatchService;

/// Threads: any.
class Service {
 public:
  /// `scratch` holds meshes and results while their requests last. `metrics` must outlive it.
  Service(const ServiceLimits& limits, ApiKeys keys, std::unique_ptr<ScratchFolder> scratch,
          Metrics& metrics);

  const ServiceLimits& limits() const { return limits_; }
  const ApiKeys& keys() const { return keys_; }
  Metrics& metrics() { return metrics_; }

  /// A place for one more request. Refuses: kTooMany; kUnavailable while draining.
  Answer<RequestSlot> Enter();

  Answer<Upload> BeginUpload();
  /// Samples the open file `mesh`, whose name in messages is `name`; waits for its turn first. The
  /// options have not been checked. Refuses: what CommandOf, Admission and the job refuse.
  Answer<Sampled> Sample(const v1::SampleOptions& options, int mesh, const std::string& name,
                         const JobWatch& watch);

  /// Models and jobs. Refuses: kNotImplemented where the service has no data folder.
  Answer<StoredService*> stored() const;
  /// Null: none. Set before the service is shared.
  void SetStored(StoredService* stored) { stored_ = stored; }

  /// Batches over the repository. Refuses: kNotImplemented where the service has none.
  Answer<BatchService*> batches() const;
  /// Null: none. Set before the service is shared.
  void SetBatches(BatchService* batches) { batches_ = batches; }
  /// A place and memory among the jobs, for as long as a batch runs; it was
  /// accepted before. Refuses: over-limit, cancelled.
  Answer<Ticket> AdmitBatch(std::uint64_t bytes, const std::function<bool()>& gone) {
    return admission_.Enter(bytes, gone, Admission::Full::kWait);
  }

  /// Whether new requests are taken.
  bool ready() const { return !draining_; }
  /// From now on HTTP answers for health and figures, and nothing else. Before it is shared.
  void AnswerProbesAlone() { probes_alone_ = true; }
  bool probes_alone() const { return probes_alone_; }
  std::uint32_t requests_in_flight() const { return in_flight_; }
  /// From now on Enter refuses.
  void Drain() { draining_ = true; }
  bool cancelled() const { return cancelled_; }
  /// Ends every job that runs or waits, as if its client had gone.
  void CancelJobs() { cancelled_ = true; }

 private:
  Answer<Sampled> Run(const internal::WorkerJob& job, int mesh, const JobWatch& watch);

  const ServiceLimits limits_;
  const ApiKeys keys_;
  const std::unique_ptr<ScratchFolder> scratch_;
  Metrics& metrics_;
  Admission admission_;
  StoredService* stored_ = nullptr;
  BatchService* batches_ = nullptr;
  bool probes_alone_ = false;
  std::atomic<std::uint32_t> in_flight_{0};
  std::atomic<bool> draining_{false}, cancelled_{false};
};

}  // namespace strata::server
