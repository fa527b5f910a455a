// One worker process of a batch, and what it makes of a model.
#pragma once

#include <functional>
#include <string>

#include "core/result.h"
#include "server/batch/batch_config.h"
#include "server/batch/manifest.h"
#include "server/batch/places.h"
#include "server/batch/schedule.h"
#include "server/service/worker_process.h"

namespace strata::server {

/// Bytes of memory of one job, among others and alone.
struct MemoryParts {
  std::uint32_t lanes = 1;  ///< How many jobs that allows at a time, at least 1.
  std::uint64_t small_bytes = 0, whole_bytes = 0;
};

/// Divides --memory: what this process and its idle workers take is not the jobs'.
/// Precondition: memory_bytes >= kLeastBatchMemory.
MemoryParts DivideMemory(std::uint64_t memory_bytes, std::uint32_t jobs, std::size_t models);

/// What all lanes of a batch share. Threads: any.
struct BatchShop {
  const BatchCommand& command;
  ModelSource& source;
  OutputPlace& outputs;
  std::string state;  ///< The folder of state.
  MemoryParts memory;
  std::uint32_t small_threads = 1;
  std::function<bool()> gone;  ///< The batch is to end now.
};

/// What became of a task.
struct TaskOutcome {
  enum class Kind { kSampled, kUnchanged, kFailed, kGone } kind = Kind::kFailed;
  ManifestLine line;
  bool not_its_fault = false;  ///< Of a failure: worth another try.
};

/// A thread's own worker process: started when it is needed, and again when it has grown or was
/// lost. Threads: one.
class BatchLane {
 public:
  explicit BatchLane(const BatchShop& shop) : shop_(shop) {}

  /// Samples one model: its output stands in its place, whole, or nothing has changed there.
  TaskOutcome Run(const BatchTask& task);

 private:
  internal::WorkerJob JobOf(const BatchTask& task, const std::string& input,
                            const std::string& output) const;
  TaskOutcome RunFetched(const BatchTask& task, const LocalModel& model);
  TaskOutcome Hear(const BatchTask& task, const internal::WorkerJob& job);
  void RecycleIfGrown(const internal::WorkerFigures& figures);

  const BatchShop& shop_;
  WorkerProcess worker_;
  int jobs_done_ = 0;  // By this worker.
};

}  // namespace strata::server
