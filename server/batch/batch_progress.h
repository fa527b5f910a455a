// How far a batch is, for a person.
#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>

#include "core/stopwatch.h"

namespace strata::server {

/// Counts of a batch.
struct BatchTally {
  std::uint64_t models = 0;       ///< That the batch is about.
  std::uint64_t skipped = 0;      ///< Sampled by a former batch, and unchanged.
  std::uint64_t kept_failed = 0;  ///< Failed in a former batch, by their own fault, and unchanged.
  std::uint64_t sampled = 0, failed = 0;
  std::uint64_t retried = 0;  ///< Tried again.
  std::uint64_t samples = 0;  ///< Of those sampled now.
  std::uint64_t pruned = 0;
  std::map<std::string, std::uint64_t> reasons;  ///< Of the failed, by type.

  std::uint64_t done() const { return skipped + kept_failed + sampled + failed; }
  std::uint64_t all_failed() const { return kept_failed + failed; }
};

/// One line: models done, rate, time left, failures. `cost_done` of `cost` is how much of the work
/// that there was at the start is done, in whatever unit.
std::string BatchProgressLine(const BatchTally& tally, double seconds, double cost_done,
                              double cost);
/// The same for programs, on one line: counts by name, "seconds", and "seconds_left" where it is
/// known.
std::string BatchProgressJson(const BatchTally& tally, double seconds, double cost_done,
                              double cost);
/// The summary of a batch that has come to its end. Several lines.
std::string BatchSummary(const BatchTally& tally, double seconds);

/// Counts what happens and says so on a descriptor: a line that is redrawn on a terminal, else a
/// line every so often; failures at once. Threads: any.
class BatchProgress {
 public:
  /// `quiet`: failures alone.
  BatchProgress(bool quiet, std::chrono::seconds interval, int fd = 2);

  /// Work that is done or known before the first task. `cost` of all tasks.
  void Begin(const BatchTally& tally, double cost);
  enum class End { kSampled, kSkipped, kFailed, kFailedBefore };
  /// A model has come to its end; `reason` and `message` are of one that failed, which is said
  /// unless a former batch has said it.
  void Add(End end, double cost, std::uint64_t samples, const std::string& path,
           const std::string& reason = {}, const std::string& message = {});
  void AddRetry(const std::string& path, const std::string& message);
  void SetPruned(std::uint64_t count);
  /// Redraws where it is due; call about ten times a second.
  void Tick();
  /// Erases the line.
  void Stop();

  /// As BatchProgressJson.
  std::string Json() const;
  BatchTally tally() const;
  double seconds() const { return watch_.seconds(); }

 private:
  void Say(const std::string& line);

  const bool quiet_, terminal_;
  const std::chrono::seconds interval_;
  const int fd_;
  const Stopwatch watch_;
  mutable std::mutex mutex_;
  BatchTally tally_;
  double cost_ = 0, cost_done_ = 0, said_at_ = 0;
};

}  // namespace strata::server
