// Which model of a batch is sampled next, and beside how many others.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "server/batch/model_options.h"
#include "server/batch/places.h"

namespace strata::server {

/// One model to be sampled. What it points at outlives it.
struct BatchTask {
  const ModelEntry* model = nullptr;
  const ModelOptions* options = nullptr;
  std::string known_sha256;    ///< Bytes that are sampled already; empty: none.
  std::string picture;         ///< Below the folder of state; empty: none is wanted.
  double cost = 0;             ///< How long it may take; seconds of one processor.
  bool whole_machine = false;  ///< All processors and all memory, and no other model beside it.
  int attempt = 1;
};

/// The tasks of a batch. Large ones go first, each with the whole machine; then small ones beside
/// each other; last those that are tried again with the whole machine. So nothing waits for ever:
/// every queue comes to its end. Threads: any.
class Schedule {
 public:
  /// Tasks in the order in which they are taken, within their kind.
  explicit Schedule(std::vector<BatchTask> tasks);

  /// The next task; blocks while none may start. Nothing: all is done, or stopped.
  std::optional<BatchTask> Take();
  /// A task that was taken has ended.
  void End(const BatchTask& task);
  /// A task that was taken goes back, to be tried again.
  void Retry(BatchTask task);
  /// From now on there is nothing to take.
  void Stop();

 private:
  bool Free() const { return running_ == 0; }
  std::optional<BatchTask> Pop(std::deque<BatchTask>& queue);
  void Release(const BatchTask& task);

  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<BatchTask> large_, small_, again_;
  std::size_t running_ = 0;
  bool exclusive_ = false;  // The one that runs has the whole machine.
  bool stopped_ = false;
};

}  // namespace strata::server
