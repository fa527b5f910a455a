// What a worker says of a job's files beside sampling them: their hashes, and what memory it took.
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "server/service/companions_seen.h"
#include "strata/internal/worker.pb.h"

namespace strata::server {

/// Of one job that names its files, while it runs. Threads: one.
class JobFiles {
 public:
  explicit JobFiles(const internal::WorkerJob& job);

  /// Where the mesh's companions are, if the job wants hashes: whatever is opened there stands in
  /// the figures. Else null.
  std::shared_ptr<const io::CompanionFiles> companions() const { return companions_; }

  /// Hashes the input, if the job wants hashes. Whether it is to be sampled: not if it cannot be
  /// read or has the hash that is known.
  bool Begin();
  /// Fills in the figures. Returns the outcome of the job, which fails too where a hash cannot be
  /// had or the input is no longer the one that was hashed. Errors: the job's; kIo, kNotFound.
  template <class T>
  Result<void> End(const Result<T>& outcome, internal::WorkerFigures& figures) {
    return Finish(outcome ? Result<void>() : Result<void>(Forward(outcome)), figures);
  }

 private:
  Result<void> Finish(Result<void> outcome, internal::WorkerFigures& figures);
  Result<void> HashInput();

  const internal::WorkerJob& job_;
  std::shared_ptr<const CompanionsSeen> companions_;
  Result<void> begun_;
  std::string input_sha256_, input_state_;
  std::uint64_t input_bytes_ = 0;
  bool unchanged_ = false;
};

/// As strata.internal.WorkerFigures.output_sha256. Errors: kIo, kNotFound.
Result<std::string> HashOutput(const std::string& path);

}  // namespace strata::server
