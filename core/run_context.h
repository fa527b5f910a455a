// What every long call takes: memory budget, scratch space, cancel and progress in one handle.
#pragma once

#include <atomic>
#include <cstdint>

#include "core/memory_account.h"
#include "core/result.h"
#include "core/scratch.h"

namespace strata {

class CheckpointPlace;

/// One job's account of memory, scratch space, cancel flag and progress. Threads: every member may
/// be used from any thread.
/// Long calls poll `cancelled()` at least once a batch.
class RunContext {
 public:
  enum class Stage : int { kOpen, kScan, kReject, kWrite, kDone };

  explicit RunContext(std::uint64_t memory_budget = MemoryAccount::kUnlimited)
      : memory_(memory_budget) {}

  MemoryAccount& memory() { return memory_; }
  /// Null, as at first: nothing goes to disk. Set before the job starts; must outlive its results.
  void SetScratch(ScratchFolder* scratch) { scratch_ = scratch; }
  ScratchFolder* scratch() const { return scratch_; }

  /// Null, as at first: nothing outlives a killed process. Set before the job starts; must outlive
  /// its results.
  void SetCheckpoints(CheckpointPlace* place) { checkpoints_ = place; }
  CheckpointPlace* checkpoints() const { return checkpoints_; }

  void Cancel() { cancelled_.store(true, std::memory_order_relaxed); }
  bool cancelled() const { return cancelled_.load(std::memory_order_relaxed); }

  void SetStage(Stage stage) { stage_.store(stage, std::memory_order_relaxed); }
  Stage stage() const { return stage_.load(std::memory_order_relaxed); }
  /// Progress of the stage: `done` of `total` bytes of input; total 0 = unknown.
  void SetProgress(std::uint64_t done, std::uint64_t total) {
    done_.store(done, std::memory_order_relaxed);
    total_.store(total, std::memory_order_relaxed);
  }
  std::uint64_t done() const { return done_.load(std::memory_order_relaxed); }
  std::uint64_t total() const { return total_.load(std::memory_order_relaxed); }
  void AddTriangles(std::uint64_t n) { triangles_.fetch_add(n, std::memory_order_relaxed); }
  std::uint64_t triangles() const { return triangles_.load(std::memory_order_relaxed); }

 private:
  MemoryAccount memory_;
  ScratchFolder* scratch_ = nullptr;
  CheckpointPlace* checkpoints_ = nullptr;
  std::atomic<bool> cancelled_{false};
  std::atomic<Stage> stage_{Stage::kOpen};
  std::atomic<std::uint64_t> done_{0}, total_{0}, triangles_{0};
};

/// The error every cancelled call returns.
inline tl::unexpected<Error> Cancelled() { return Fail(ErrorCode::kCancelled, "cancelled"); }

}  // namespace strata
