#include "core/scan.h"

#include <tbb/blocked_range.h>
#include <tbb/concurrent_queue.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "core/batch_race.h"
#include "core/subdivide.h"

namespace strata {
namespace {

constexpr double kSharedCells = 1 << 15;  // A triangle over more cells is shared among threads.

constexpr std::size_t kBatchesBeforeMore = 32;  // As many again for each batch more at a time.

// Batches on their way through the pipeline, with what came of them.
struct Job {
  std::vector<std::unique_ptr<TriangleBatch>> batches;  // The first `used` of them.
  std::vector<BatchTotals> totals;
  std::size_t used = 0;
};

// What a thread keeps between batches.
struct Worker {
  Worker(ReservoirStore& store, const ScanOptions& options)
      : racer(store, options.kernel,
              {options.kernel.lambda, options.kernel.seed, options.barycentric},
              options.batch_size),
        lanes(options.batch_size) {}
  BatchRacer racer;
  TriangleLanes lanes;
  SkipCounts skipped{};
  std::uint64_t thin = 0;  // Large triangles without a piece.
};

class Scanner {
 public:
  Scanner(MeshReader& reader, const ScanOptions& options, ReservoirStore& store,
          RunContext& context, const ScanCheckpoints& checkpoints)
      : reader_(reader),
        options_(options),
        store_(store),
        context_(context),
        checkpoints_(checkpoints),
        workers_([&] { return Worker(store_, options_); }),
        share_(options.share),
        next_(checkpoints.from.next),
        totals_(checkpoints.from.totals) {}

  Result<ScanTotals> Run() {
    if (!checkpoints_.from.complete) {
      Begin();
      for (RunPipeline(); at_checkpoint_ && !Stopped(); RunPipeline()) TakeCheckpoint(false);
    }
    return Finish();
  }

 private:
  void Begin() {
    share_.first = next_;
    selected_ = reader_.SelectShare(share_);
    if (selected_ && next_ > 0) {
      read_before_ = totals_.read;
      read_before_.Subtract(reader_.counts());
    }
    for (std::size_t i = 0; i < Tokens(); ++i) {
      jobs_.push_back(std::make_unique<Job>());
      free_.push(jobs_.back().get());
    }
  }

  std::size_t Tokens() const { return static_cast<std::size_t>(2 * options_.threads); }

  // Until the end of the mesh, a failure, or the next checkpoint.
  void RunPipeline() {
    at_checkpoint_ = false;
    tbb::parallel_pipeline(
        Tokens(),
        tbb::make_filter<void, Job*>(tbb::filter_mode::serial_in_order,
                                     [&](tbb::flow_control& flow) { return Next(flow); }) &
            tbb::make_filter<Job*, Job*>(tbb::filter_mode::parallel,
                                         [&](Job* job) {
                                           if (!Failed()) Process(*job);
                                           return job;
                                         }) &
            tbb::make_filter<Job*, void>(tbb::filter_mode::serial_in_order,
                                         [&](Job* job) { AddTotals(*job); }));
  }

  // Nothing is under way.
  void TakeCheckpoint(bool complete) {
    FlushWorkers();
    store_.Checkpoint([save = checkpoints_.save, state = ScanState{next_, complete, Totals()}](
                          std::span<const RunExtent> runs) { return save(state, runs); });
  }

  Job* Next(tbb::flow_control& flow) {
    if (context_.cancelled()) Fail(Error{ErrorCode::kCancelled, "cancelled"});
    at_checkpoint_ = checkpoints_.save && store_.wants_checkpoint();
    Job* job = nullptr;
    if (at_checkpoint_ || Failed() || store_.full() || !free_.try_pop(job)) {
      flow.stop();
      return nullptr;
    }
    if (!Fill(*job)) {
      free_.push(job);
      flow.stop();
      return nullptr;
    }
    return job;
  }

  // False at the end of the mesh.
  bool Fill(Job& job) {
    const std::size_t wanted =
        std::min(options_.most_batches, 1 + batches_read_ / kBatchesBeforeMore);
    job.used = 0;
    while (job.used < wanted) {
      if (job.used == job.batches.size()) {
        job.batches.push_back(std::make_unique<TriangleBatch>(options_.batch_size));
      }
      auto count = reader_.Read(*job.batches[job.used]);
      if (!count) Fail(count.error());
      if (!count || *count == 0) break;
      next_ = job.batches[job.used]->ids()[*count - 1] + 1;
      KeepShare(*job.batches[job.used]);
      ++job.used;
      context_.SetProgress(reader_.bytes_read(), reader_.bytes_total().value_or(0));
      context_.AddTriangles(*count);
    }
    batches_read_ += job.used;
    job.totals.assign(job.used, {});
    return job.used > 0;
  }

  void KeepShare(TriangleBatch& batch) const {
    if (selected_) return;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < batch.size(); ++i) {
      if (!share_.Holds(batch.ids()[i])) continue;
      for (int k = 0; k < 9; ++k) batch.column(k)[kept] = batch.column(k)[i];
      batch.ids()[kept++] = batch.ids()[i];
    }
    batch.set_size(kept);
  }

  void Process(Job& job) {
    Worker& worker = workers_.local();
    for (std::size_t i = 0; i < job.used && !Stopped(); ++i) {
      const ClassifiedBatch batch{*job.batches[i], worker.lanes};
      worker.lanes.totals = {};
      ClassifyTriangles(batch.batch, options_.kernel, worker.lanes);
      ProcessBatch(batch, worker);
      job.totals[i] = worker.lanes.totals;
    }
  }

  void ProcessBatch(const ClassifiedBatch& in, Worker& worker) {
    for (std::size_t k = 0; k < in.lanes.rare_size && !Stopped(); ++k) {
      Settle(in, in.lanes.rare[k], worker);
    }
    if (options_.integrator == Integrator::kSubdivide) {
      SubdivideAll(in, worker);
      return;
    }
    worker.racer.RaceGathered(in);
    worker.racer.Race(in);
  }

  void Settle(const ClassifiedBatch& in, std::size_t i, Worker& worker) {
    switch (static_cast<TriangleKind>(in.lanes.kind[i])) {
      case TriangleKind::kUnusable:
        CountSkipped(in.batch, i, worker);
        break;
      case TriangleKind::kFar:
        FailFar(in.batch.ids()[i]);
        break;
      default:
        if (options_.integrator == Integrator::kExact) CutLarge(in, i, worker);
    }
  }

  void CountSkipped(const TriangleBatch& batch, std::size_t i, Worker& worker) {
    bool finite = true;
    Vec3 n;
    for (int k = 0; k < 9; ++k) finite &= std::isfinite(batch.column(k)[i]);
    if (finite) {
      n = Cross(batch.corner(i, 1) - batch.corner(i, 0), batch.corner(i, 2) - batch.corner(i, 0));
    }
    // Finite corners whose area overflows a double are as good as infinite.
    const bool zero = finite && std::isfinite(Norm2(n));
    const SkipReason reason = zero ? SkipReason::kZeroArea : SkipReason::kNonFinite;
    ++worker.skipped[static_cast<std::size_t>(reason)];
    if (options_.strict) {
      Fail(Error{ErrorCode::kCorruptInput,
                 "triangle " + std::to_string(batch.ids()[i]) +
                     " (counted from 0): " + (zero ? "area is zero" : "a corner is not finite") +
                     "; --strict wants every triangle to count"});
    }
  }

  void FailFar(std::uint64_t id) {
    Fail(Error{ErrorCode::kOverBudget,
               "triangle " + std::to_string(id) +
                   " lies more than 2^30 cells from the lattice's origin; use a coarser lattice"});
  }

  void CutLarge(const ClassifiedBatch& in, std::size_t i, Worker& worker) {
    const RaceTriangle triangle = PrepareTriangle(in, i, options_.kernel.lattice);
    const SlabRange slabs = SlabsOf(triangle);
    const auto cut = [&](std::int32_t begin, std::int32_t end, Worker& by) {
      return by.racer.GatherPieces(in, triangle, i, slabs, begin, end, context_);
    };
    if (IsThin(triangle, slabs)) {
      worker.racer.RaceGathered(in);
      const std::uint64_t before = worker.racer.pieces();
      cut(slabs.begin, slabs.end, worker);
      worker.racer.RaceGathered(in);
      worker.thin += worker.racer.pieces() == before;
      return;
    }
    if (slabs.cells < kSharedCells || options_.threads == 1) {
      cut(slabs.begin, slabs.end, worker);
      return;
    }
    // Isolated: a thread that waits here must not take up another batch, which would use the same
    // worker's buffers.
    tbb::this_task_arena::isolate([&] {
      tbb::parallel_for(tbb::blocked_range<std::int32_t>(slabs.begin, slabs.end),
                        [&](const auto& range) {
                          if (Stopped()) return;
                          Worker& by = workers_.local();
                          cut(range.begin(), range.end(), by);
                          by.racer.RaceGathered(in);
                        });
    });
  }

  void SubdivideAll(const ClassifiedBatch& in, Worker& worker) {
    for (std::size_t i = 0; i < in.batch.size() && !Stopped(); ++i) {
      if (static_cast<TriangleKind>(in.lanes.kind[i]) == TriangleKind::kUnusable) continue;
      if (static_cast<TriangleKind>(in.lanes.kind[i]) == TriangleKind::kFar) continue;
      worker.racer.AddPieces(SubdivideTriangle(PrepareTriangle(in, i, options_.kernel.lattice),
                                               worker.racer.sink(), context_));
    }
  }

  // In file order, so that the sum of the areas does not depend on who was faster.
  void AddTotals(Job& job) {
    for (const BatchTotals& batch : job.totals) {
      totals_.batch.surface.Add(batch.surface);
      if (!batch.bounds.empty()) {
        totals_.batch.bounds.Add(batch.bounds.min);
        totals_.batch.bounds.Add(batch.bounds.max);
      }
      totals_.batch.area += batch.area;
      totals_.batch.usable += batch.usable;
      totals_.batch.probes_found |= batch.probes_found;
    }
    free_.push(&job);
  }

  Result<ScanTotals> Finish() {
    if (context_.cancelled()) return Cancelled();
    FlushWorkers();
    if (auto stored = store_.status(); !stored) return Forward(stored);
    if (failure_) return tl::unexpected<Error>(*failure_);
    // Even if a former process had the whole scan: the store saves it anew when its runs merge.
    if (checkpoints_.save && !store_.in_memory()) {
      TakeCheckpoint(true);
      if (auto stored = store_.status(); !stored) return Forward(stored);
    }
    ScanTotals totals = Totals();
    totals.skipped[static_cast<std::size_t>(SkipReason::kZeroArea)] += totals.thin;
    return totals;
  }

  void FlushWorkers() {
    std::vector<Worker*> all;
    for (Worker& worker : workers_) all.push_back(&worker);
    tbb::parallel_for(std::size_t{0}, all.size(),
                      [&](std::size_t i) { all[i]->racer.sink().Flush(); });
  }

  // Of all that went through the pipeline. Nothing is under way.
  ScanTotals Totals() {
    ScanTotals all = totals_;
    if (checkpoints_.from.complete) return all;
    for (const Worker& worker : workers_) {
      for (std::size_t r = 0; r < all.skipped.size(); ++r) all.skipped[r] += worker.skipped[r];
      all.pieces += worker.racer.pieces();
      all.thin += worker.racer.thin() + worker.thin;
    }
    all.read = {};
    if (!selected_ && share_.index != 0) return all;
    all.read = read_before_;
    all.read.Add(reader_.counts());
    return all;
  }

  // Whether more work would be in vain. A large triangle's cells may be millions: asked before
  // each.
  bool Stopped() const { return Failed() || store_.full() || context_.cancelled(); }
  bool Failed() const { return failed_.load(std::memory_order_relaxed); }
  // The first failure stands; the rest of the pipeline drains.
  void Fail(Error error) {
    const std::lock_guard<std::mutex> lock(failure_mutex_);
    if (!failure_) failure_ = std::move(error);
    failed_.store(true, std::memory_order_relaxed);
  }

  MeshReader& reader_;
  const ScanOptions& options_;
  ReservoirStore& store_;
  RunContext& context_;
  const ScanCheckpoints& checkpoints_;
  tbb::enumerable_thread_specific<Worker> workers_;
  std::vector<std::unique_ptr<Job>> jobs_;
  tbb::concurrent_queue<Job*> free_;
  std::size_t batches_read_ = 0;
  Share share_;
  bool selected_ = true;    // The reader gives the share's triangles only.
  ReadCounts read_before_;  // What a former scan read and this one's reader passes over.
  std::uint64_t next_;      // The number of the next triangle in the file.
  bool at_checkpoint_ = false;
  ScanTotals totals_;  // But for what the workers have, and what was read.
  std::atomic<bool> failed_{false};
  std::mutex failure_mutex_;
  std::optional<Error> failure_;
};

}  // namespace

std::uint64_t WorkerBytes(std::size_t batch_size, std::size_t most_batches) {
  constexpr std::uint64_t kTriangle = 9 * sizeof(double) + sizeof(std::uint64_t);
  constexpr std::uint64_t kRacer = 12 << 20, kLanes = 400;
  return kRacer + batch_size * (kLanes + 2 * most_batches * kTriangle);
}

Result<ScanTotals> ScanTriangles(MeshReader& reader, const ScanOptions& options,
                                 ReservoirStore& store, RunContext& context,
                                 const ScanCheckpoints& checkpoints) {
  return Scanner(reader, options, store, context, checkpoints).Run();
}

}  // namespace strata
