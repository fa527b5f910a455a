#include "core/sample_mesh.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/arena.h"
#include "core/carry_attributes.h"
#include "core/checkpoint.h"
#include "core/enclosing_ball.h"
#include "core/gather.h"
#include "core/race.h"
#include "core/region.h"
#include "core/rejection.h"
#include "core/reservoir_grid.h"
#include "core/scan.h"
#include "core/scan_mesh.h"
#include "core/stopwatch.h"
#include "core/triangle_hash.h"
#include "core/uniform.h"

namespace strata {
namespace {

constexpr std::size_t kMaxProbes = 8;

std::string Number(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", v);
  return text;
}

bool IsEdgeAllowed(double edge) { return edge >= kMinEdge && edge <= kMaxEdge; }

Result<void> CheckEdge(double edge) {
  if (IsEdgeAllowed(edge)) return {};
  return Fail(ErrorCode::kOverBudget, "the cells' edge would be " + Number(edge) +
                                          "; expected 1e-60 to 1e60; use other units");
}

Result<void> CheckLattice(const LatticeSpec& spec) {
  if (const auto* r = std::get_if<Resolution>(&spec); r && (r->n < 1 || r->n > kMaxResolution)) {
    return Fail(ErrorCode::kInvalidArgument,
                "resolution is " + std::to_string(r->n) + "; expected 1 to 536870912");
  }
  if (const auto* v = std::get_if<VoxelSize>(&spec); v && !IsEdgeAllowed(v->edge)) {
    return Fail(ErrorCode::kInvalidArgument,
                "voxel size is " + Number(v->edge) + "; expected 1e-60 to 1e60");
  }
  if (const auto* h = std::get_if<Height>(&spec); h && (h->h < 1 || h->h > kMaxHeight)) {
    return Fail(ErrorCode::kInvalidArgument,
                "height is " + std::to_string(h->h) + "; expected 1 to 30");
  }
  return {};
}

// A lattice, and what must hold of the surface for it to be the right one. Vertices are at hand
// before the first triangle is read, so the lattice is taken from all of them; that is wrong only
// if one that matters belongs to no usable triangle, which the scan finds out.
struct LatticeChoice {
  Lattice lattice;
  std::optional<Bounds> bounds;       // The surface's bounds must equal these.
  std::vector<std::uint64_t> probes;  // The surface must have these vertices.

  bool Holds(const BatchTotals& found) const {
    if (bounds && !(*bounds == found.bounds)) return false;
    return found.probes_found == (1u << probes.size()) - 1;
  }
};

Result<LatticeChoice> ChoiceOf(const Checkpoint& checkpoint) {
  return LatticeChoice{checkpoint.lattice, checkpoint.bounds, checkpoint.probes};
}

// Calls `visit` with the corners of every usable triangle.
template <class F>
Result<void> ForEachUsable(MeshReader& reader, RunContext& context, F&& visit) {
  if (auto rewound = reader.Rewind(); !rewound) return Forward(rewound);
  TriangleBatch batch(2048);
  for (;;) {
    if (context.cancelled()) return Cancelled();
    const auto count = reader.Read(batch);
    if (!count) return Forward(count);
    if (*count == 0) return {};
    context.SetProgress(reader.bytes_read(), reader.bytes_total().value_or(0));
    for (std::size_t i = 0; i < batch.size(); ++i) {
      const Vec3 a = batch.corner(i, 0), b = batch.corner(i, 1), c = batch.corner(i, 2);
      if (IsUsable(CanonicalAreaVector(a, b, c))) visit(a), visit(b), visit(c);
    }
  }
}

Result<LatticeChoice> FromSurface(MeshReader& reader, const LatticeSpec& spec, int& passes,
                                  RunContext& context) {
  LatticeChoice choice;
  if (const auto* resolution = std::get_if<Resolution>(&spec)) {
    Bounds bounds;
    auto pass = ForEachUsable(reader, context, [&](Vec3 p) { bounds.Add(p); });
    ++passes;
    if (!pass) return Forward(pass);
    if (bounds.empty()) return Fail(ErrorCode::kEmptySurface, "no triangle of positive area");
    choice.lattice = LatticeFor(bounds, *resolution);
  } else {
    auto ball = EnclosingBallOfStream([&](const PointVisitor& visit) {
      ++passes;
      return ForEachUsable(reader, context, visit);
    });
    if (!ball) return Forward(ball);
    choice.lattice = LatticeFor(ball->ball.center, ball->ball.radius, std::get<Height>(spec));
  }
  if (auto rewound = reader.Rewind(); !rewound) return Forward(rewound);
  return choice;
}

// Bounds of the finite coordinates, twelve running at once so that compilers can use vectors. (A
// vertex with a coordinate that is not finite is in no usable triangle, so if its others matter
// here, LatticeChoice::Holds finds out.)
template <class T>
Bounds BoundsOf(std::span<const T> xyz) {
  constexpr std::size_t kRun = 12;
  constexpr T kMost = std::numeric_limits<T>::max();
  T low[kRun], high[kRun];
  std::fill(low, low + kRun, kMost);
  std::fill(high, high + kRun, -kMost);
  const auto visit = [&](std::size_t i, std::size_t k) {
    const T v = xyz[i + k];
    low[k] = v < low[k] && v >= -kMost ? v : low[k];
    high[k] = v > high[k] && v <= kMost ? v : high[k];
  };
  std::size_t i = 0;
  for (; i + kRun <= xyz.size(); i += kRun) {
    for (std::size_t k = 0; k < kRun; ++k) visit(i, k);
  }
  for (std::size_t k = 0; i + k < xyz.size(); ++k) visit(i, k);
  Bounds bounds;
  for (std::size_t k = 0; k < kRun; k += 3) {
    if (low[k] > high[k] || low[k + 1] > high[k + 1] || low[k + 2] > high[k + 2]) continue;
    bounds.Add({low[k], low[k + 1], low[k + 2]});
    bounds.Add({high[k], high[k + 1], high[k + 2]});
  }
  return bounds;
}

// A vertex that no triangle uses may lie so far away that the lattice of all vertices is useless,
// or that extents overflow.
bool IsSound(const Lattice& lattice) {
  const Vec3 o = lattice.origin;
  return IsEdgeAllowed(lattice.edge) && std::isfinite(o.x) && std::isfinite(o.y) &&
         std::isfinite(o.z);
}

// The bounds of all vertices; empty without a vertex list.
Result<Bounds> BoundsOfVertices(MeshReader& reader) {
  Bounds bounds;
  auto visited = reader.VisitVertices([&](const VertexView& some) {
    const Bounds more = some.f32.empty() ? BoundsOf(some.f64) : BoundsOf(some.f32);
    if (!more.empty()) bounds.Add(more.min), bounds.Add(more.max);
  });
  if (!visited) return Forward(visited);
  return bounds;
}

// The same for the smallest ball; kEmptySurface without a vertex list.
Result<StreamedBall> BallOfVertices(MeshReader& reader) {
  if (reader.vertices().size() > 0) return EnclosingBallOfVertices(reader.vertices());
  return EnclosingBallOfStream([&](const PointVisitor& visit) -> Result<void> {
    auto visited = reader.VisitVertices([&](const VertexView& some) {
      for (std::size_t i = 0; i < some.size(); ++i) {
        const Vec3 p = some[i];
        if (std::isfinite(p.x + p.y + p.z)) visit(p);
      }
    });
    if (!visited) return Forward(visited);
    return {};
  });
}

using MaybeChoice = std::optional<LatticeChoice>;

Result<MaybeChoice> FromVertices(MeshReader& reader, const LatticeSpec& spec) {
  LatticeChoice choice;
  if (const auto* resolution = std::get_if<Resolution>(&spec)) {
    const auto found = BoundsOfVertices(reader);
    if (!found) return Forward(found);
    const Bounds& bounds = *found;
    if (bounds.empty() || bounds.min == bounds.max) return MaybeChoice();
    choice.bounds = bounds;
    choice.lattice = LatticeFor(bounds, *resolution);
    return IsSound(choice.lattice) ? MaybeChoice(choice) : MaybeChoice();
  }
  const auto ball = BallOfVertices(reader);
  if (!ball && ball.error().code != ErrorCode::kEmptySurface) return Forward(ball);
  if (!ball || ball->support.size() > kMaxProbes) return MaybeChoice();
  for (const Vec3& p : ball->support) choice.probes.push_back(HashVertex(p));
  choice.lattice = LatticeFor(ball->ball.center, ball->ball.radius, std::get<Height>(spec));
  return IsSound(choice.lattice) ? MaybeChoice(choice) : MaybeChoice();
}

// --- Shares of the memory budget --------------------------------------------------------------

struct ScanPlan {
  StoreLimits store;
  int threads;
  std::size_t most_batches;
};

// Each worker's buffers come first; what is left goes to the reservoirs.
Result<ScanPlan> PlanScan(const SampleOptions& options, RunContext& context) {
  ScanPlan plan;
  plan.threads = tbb::this_task_arena::max_concurrency();
  plan.most_batches = kMostBatches;
  plan.store.max_cells = options.max_cells;
  plan.store.barycentric = (options.attributes & kBarycentric) != 0;
  const MemoryAccount& memory = context.memory();
  if (!memory.limited()) return plan;
  plan.store.scratch = context.scratch();
  if (plan.store.scratch != nullptr) plan.store.checkpoints = context.checkpoints();
  plan.store.context = &context;
  const std::uint64_t left = memory.left();
  std::uint64_t worker = WorkerBytes(options.batch_size, plan.most_batches);
  if (left / 8 / worker < static_cast<std::uint64_t>(plan.threads)) {
    plan.most_batches = 2;
    worker = WorkerBytes(options.batch_size, plan.most_batches);
  }
  const std::uint64_t least = 2 * worker;
  if (left < least) {
    return Fail(ErrorCode::kOverBudget, "the scan needs at least " + std::to_string(least) +
                                            " bytes of the memory budget; " + std::to_string(left) +
                                            " of " + std::to_string(memory.budget()) + " are left");
  }
  // A third of it at most for the workers.
  plan.threads = static_cast<int>(
      std::clamp<std::uint64_t>(left / 3 / worker, 1, static_cast<std::uint64_t>(plan.threads)));
  plan.store.max_bytes = (left - static_cast<std::uint64_t>(plan.threads) * worker) / 10 * 9;
  if (plan.store.scratch == nullptr) {
    plan.store.max_cells = std::min(plan.store.max_cells, plan.store.max_bytes / kBytesPerCell);
  }
  return plan;
}

class ScanJob {
 public:
  ScanJob(MeshReader& reader, const SampleOptions& options, RunContext& context)
      : reader_(reader), options_(options), context_(context) {}

  Result<ScannedMesh> Run(const Share& share, const std::optional<Lattice>& lattice) {
    share_ = share;
    stats().passes = 0;
    if (auto scanned = Scan(lattice); !scanned) return Forward(scanned);
    return std::move(result_);
  }

 private:
  SampleStats& stats() { return result_.stats; }

  Result<void> Scan(const std::optional<Lattice>& lattice) {
    const Stopwatch watch;
    // The lattice is that of the whole surface, whatever share the reader gave before.
    reader_.SelectShare({});
    const auto former = LoadCheckpoint();
    if (!former) return Forward(former);
    auto choice = *former ? ChoiceOf(**former) : Choose(lattice);
    if (!choice) return Forward(choice);
    stats().lattice_seconds = watch.seconds();
    auto totals = ScanOn(*choice, *former);
    if (!totals) return Forward(totals);
    if (totals->batch.usable == 0 && share_.count == 1) {
      return Fail(ErrorCode::kEmptySurface, "no triangle of positive area among " +
                                                std::to_string(reader_.counts().triangles) +
                                                " triangles");
    }
    if (!choice->Holds(totals->batch)) {
      reader_.SelectShare({});
      choice = FromSurface(reader_, options_.lattice, stats().passes, context_);
      if (!choice) return Forward(choice);
      totals = ScanOn(*choice, {});
      if (!totals) return Forward(totals);
    }
    return Note(*choice, *totals);
  }

  Result<LatticeChoice> Choose(const std::optional<Lattice>& given) {
    if (given) return LatticeChoice{*given, {}, {}};
    if (const auto* voxel = std::get_if<VoxelSize>(&options_.lattice)) {
      return LatticeChoice{LatticeFor(*voxel), {}, {}};
    }
    // A share alone could not tell whether the lattice of all vertices is that of the surface.
    if (share_.count == 1) {
      auto from_vertices = FromVertices(reader_, options_.lattice);
      if (!from_vertices) return Forward(from_vertices);
      if (*from_vertices) return **from_vertices;
    }
    return FromSurface(reader_, options_.lattice, stats().passes, context_);
  }

  Result<std::optional<Checkpoint>> LoadCheckpoint() {
    if (context_.checkpoints() == nullptr) return std::optional<Checkpoint>();
    const auto bytes = context_.checkpoints()->Load();
    if (!bytes) return Forward(bytes);
    if (!*bytes) return std::optional<Checkpoint>();
    auto checkpoint = UnpackCheckpoint(**bytes);
    if (!checkpoint) {
      return Fail(ErrorCode::kIo,
                  "in scratch space: " + checkpoint.error().message + "; start without --resume");
    }
    stats().resumed_at = checkpoint->scan.next;
    return std::optional<Checkpoint>(std::move(*checkpoint));
  }

  // How the scan on a lattice is saved, and what it goes on from.
  ScanCheckpoints CheckpointsOf(const LatticeChoice& choice, const ScanState& from) {
    CheckpointPlace* const place = context_.checkpoints();
    if (place == nullptr) return {};
    const auto save = [place, choice](const ScanState& state,
                                      std::span<const RunExtent> runs) -> Result<void> {
      const auto bytes = PackCheckpoint({choice.lattice, choice.bounds, choice.probes, state,
                                         std::vector<RunExtent>(runs.begin(), runs.end())});
      if (!bytes) return Forward(bytes);
      return place->Save(*bytes);
    };
    return {save, from};
  }

  Result<ScanTotals> ScanOn(const LatticeChoice& choice, const std::optional<Checkpoint>& former) {
    if (auto checked = CheckEdge(choice.lattice.edge); !checked) return Forward(checked);
    const Stopwatch watch;
    context_.SetStage(RunContext::Stage::kScan);
    const auto plan = PlanScan(options_, context_);
    if (!plan) return Forward(plan);
    result_.store = std::make_unique<ReservoirStore>(plan->store);
    if (former) {
      if (auto restored = result_.store->Restore(former->runs); !restored) return Forward(restored);
    }
    ScanOptions scan;
    scan.kernel = {choice.lattice, options_.lambda, options_.seed, choice.probes};
    scan.integrator = options_.integrator;
    scan.barycentric = (options_.attributes & kBarycentric) != 0;
    scan.strict = options_.strict;
    scan.threads = plan->threads;
    scan.batch_size = options_.batch_size;
    ++stats().passes;
    scan.most_batches = plan->most_batches;
    scan.share = share_;
    auto totals = ScanTriangles(reader_, scan, *result_.store, context_,
                                CheckpointsOf(choice, former ? former->scan : ScanState{}));
    stats().scan_seconds += watch.seconds();
    return totals;
  }

  Result<void> Note(const LatticeChoice& choice, const ScanTotals& totals) {
    SampleStats& s = stats();
    s.read = totals.read;
    for (std::size_t r = 0; r < s.skipped.size(); ++r) {
      s.skipped[r] = totals.skipped[r] + s.read.skipped[r];
    }
    s.sampled = totals.batch.usable - totals.thin;
    s.bounds = totals.batch.bounds;
    result_.surface = totals.batch.surface;
    s.mesh_area = totals.batch.area;
    s.lattice = choice.lattice;
    s.pieces = totals.pieces;
    s.surface_hash = HexOf(totals.batch.surface);
    for (std::size_t r = 0; options_.strict && r < s.skipped.size(); ++r) {
      if (s.skipped[r] == 0) continue;
      return Fail(ErrorCode::kCorruptInput, std::to_string(s.skipped[r]) +
                                                " triangles skipped: " + kSkipReasonNames[r] +
                                                "; --strict wants every triangle to count");
    }
    if (s.sampled == 0 && share_.count == 1) {
      return Fail(ErrorCode::kEmptySurface,
                  "no triangle is wider than the rounding of its corners' coordinates");
    }
    return {};
  }

  MeshReader& reader_;
  const SampleOptions& options_;
  RunContext& context_;
  Share share_;
  ScannedMesh result_;
};

GatherOptions GatherOptionsOf(const SampleStats& stats, const SampleOptions& options) {
  return {stats.lattice,       stats.bounds,       options.min_distance,
          options.lambda,      options.attributes, options.integrator == Integrator::kSubdivide,
          options.parcel_cells};
}

SampledMesh Sampled(SampleStats stats, Gathered gathered) {
  stats.cells = gathered.cells;
  stats.cell_area = gathered.cell_area;
  stats.survivors = gathered.survivors;
  stats.reject_seconds = gathered.reject_seconds;
  return {std::move(stats),
          gathered.bounds,
          std::move(gathered.parcels),
          {},
          std::move(gathered.samples)};
}

Result<SampledMesh> SampleStratified(MeshReader& reader, const SampleOptions& options,
                                     RunContext& context) {
  auto scanned = ScanMesh(reader, options, {}, {}, context);
  if (!scanned) return Forward(scanned);
  return GatherSamples(std::move(*scanned), options, context);
}

}  // namespace

Result<void> CheckOptions(const SampleOptions& o) {
  if (!(o.lambda >= 0 && o.lambda <= kMaxLambda)) {
    return Fail(ErrorCode::kInvalidArgument,
                "lambda is " + Number(o.lambda) + "; expected 0 to 500");
  }
  if (!(o.min_distance >= 0 && o.min_distance <= kMaxMinDistance)) {
    return Fail(ErrorCode::kInvalidArgument,
                "minimum distance is " + Number(o.min_distance) + "; expected 0 to 4");
  }
  if (o.threads < 0 || o.threads > 4096) {
    return Fail(ErrorCode::kInvalidArgument,
                "threads is " + std::to_string(o.threads) + "; expected 0 to 4096");
  }
  if (o.batch_size < 1 || o.batch_size > (std::size_t{1} << 20)) {
    return Fail(ErrorCode::kInvalidArgument,
                "batch size is " + std::to_string(o.batch_size) + "; expected 1 to 1048576");
  }
  if (o.count > kMaxCount) {
    return Fail(ErrorCode::kInvalidArgument,
                "count is " + std::to_string(o.count) + "; expected at most 1099511627776");
  }
  return CheckLattice(o.lattice);
}

Result<Lattice> FindLattice(MeshReader& reader, const LatticeSpec& spec, const Bounds& bounds,
                            int& passes, RunContext& context) {
  Lattice lattice;
  if (const auto* voxel = std::get_if<VoxelSize>(&spec)) {
    lattice = LatticeFor(*voxel);
  } else if (const auto* resolution = std::get_if<Resolution>(&spec)) {
    lattice = LatticeFor(bounds, *resolution);
  } else {
    const auto choice = FromSurface(reader, spec, passes, context);
    if (!choice) return Forward(choice);
    lattice = choice->lattice;
  }
  if (auto checked = CheckEdge(lattice.edge); !checked) return Forward(checked);
  return lattice;
}

std::string HexOf(const SurfaceHash& surface) {
  char hash[33];
  std::snprintf(hash, sizeof hash, "%016llx%016llx", static_cast<unsigned long long>(surface.high),
                static_cast<unsigned long long>(surface.low));
  return hash;
}

Result<ScannedMesh> ScanMesh(MeshReader& reader, const SampleOptions& options, const Share& share,
                             const std::optional<Lattice>& lattice, RunContext& context) {
  if (auto valid = CheckOptions(options); !valid) return Forward(valid);
  if (options.method != Method::kStratified) {
    return Fail(ErrorCode::kInvalidArgument,
                "the uniform method is not one of shares: sample the whole mesh at once");
  }
  return InArena(options.threads,
                 [&] { return ScanJob(reader, options, context).Run(share, lattice); });
}

Result<SampledMesh> GatherSamples(ScannedMesh scanned, const SampleOptions& options,
                                  RunContext& context) {
  return InArena(options.threads, [&]() -> Result<SampledMesh> {
    const GatherOptions gather = GatherOptionsOf(scanned.stats, options);
    const ReservoirGrid& grid = scanned.store->grid();
    const std::uint64_t needed = grid.bytes() + grid.size() * kGatherBytesPerCell;
    const bool fits = scanned.store->in_memory() && needed <= context.memory().left();
    auto gathered = fits ? GatherInMemory(std::move(scanned.store), gather, context)
                         : GatherInPasses(std::move(scanned.store), gather, context);
    if (!gathered) return Forward(gathered);
    return Sampled(std::move(scanned.stats), std::move(*gathered));
  });
}

Result<SampledMesh> GatherRegion(ScannedMesh scanned, std::span<const Partial> parts,
                                 const Region& region, const SampleOptions& options,
                                 RunContext& context) {
  return InArena(options.threads, [&]() -> Result<SampledMesh> {
    auto gathered = GatherPartials(parts, region, GatherOptionsOf(scanned.stats, options), context);
    if (!gathered) return Forward(gathered);
    return Sampled(std::move(scanned.stats), std::move(*gathered));
  });
}

Result<SampledMesh> SampleMeshStreamed(MeshReader& reader, const SampleOptions& options,
                                       RunContext& context) {
  auto plan = PlanCarry(reader.attributes(), options);
  if (!plan) return Forward(plan);
  auto left_out = LeaveOutAbsent(reader, options, *plan, context);
  if (!left_out) return Forward(left_out);
  SampleOptions of_scan = options;
  of_scan.attributes = GatheredFor(*plan, options);
  auto sampled = options.method == Method::kUniform ? SampleUniform(reader, of_scan, context)
                                                    : SampleStratified(reader, of_scan, context);
  if (!sampled) return sampled;
  sampled->stats.left_out = std::move(*left_out);
  if (plan->empty()) return sampled;
  const Stopwatch watch;
  auto carried = InArena(
      options.threads, [&] { return CarryAttributes(reader, *plan, options, *sampled, context); });
  if (!carried) return Forward(carried);
  sampled->stats.carry_seconds = watch.seconds();
  return sampled;
}

Result<SampleResult> SampleMesh(MeshReader& reader, const SampleOptions& options,
                                RunContext& context) {
  auto sampled = SampleMeshStreamed(reader, options, context);
  if (!sampled) return Forward(sampled);
  SampleResult result{{}, std::move(sampled->stats), std::move(sampled->carried)};
  SampleColumns next;
  for (;;) {
    const auto more = sampled->samples->Next(next);
    if (!more) return Forward(more);
    if (!*more) return result;
    result.samples.Append(std::move(next));
  }
}

}  // namespace strata
