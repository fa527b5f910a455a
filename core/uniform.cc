#include "core/uniform.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/arena.h"
#include "core/batch_pipeline.h"
#include "core/cell_octree.h"
#include "core/exact_sum.h"
#include "core/scan_kernel.h"
#include "core/scan_mesh.h"
#include "core/stopwatch.h"
#include "core/triangle_hash.h"
#include "core/uniform_arrivals.h"
#include "core/uniform_band.h"

namespace strata {
namespace {

constexpr std::size_t kMostCapacity = std::size_t{1} << 24;  // Of a band.
constexpr std::size_t kSamplesAtOnce = 1 << 16;
// A triangle with more windows of arrivals than this is shared among threads.
constexpr std::uint64_t kSharedWindows = 512;

// --- The first pass: how much surface there is ---------------------------------------------------

struct Survey {
  ExactSum area;
  SurfaceHash surface;
  Bounds bounds;
  SkipCounts skipped{};
  std::uint64_t usable = 0;

  void Add(const Survey& other) {
    area.Add(other.area);
    surface.Add(other.surface);
    if (!other.bounds.empty()) bounds.Add(other.bounds.min), bounds.Add(other.bounds.max);
    for (std::size_t r = 0; r < skipped.size(); ++r) skipped[r] += other.skipped[r];
    usable += other.usable;
  }
};

SkipReason WhySkipped(const TriangleBatch& batch, std::size_t i) {
  bool finite = true;
  for (int k = 0; k < 9; ++k) finite &= std::isfinite(batch.column(k)[i]);
  const Vec3 n = CanonicalAreaVector(batch.corner(i, 0), batch.corner(i, 1), batch.corner(i, 2));
  // Finite corners whose area overflows a double are as good as infinite.
  return finite && std::isfinite(Norm2(n)) ? SkipReason::kZeroArea : SkipReason::kNonFinite;
}

void AddTriangle(const TriangleBatch& batch, std::size_t i, Survey& survey) {
  const auto triangle = TriangleArrivals::Of(batch, i);
  if (!triangle) {
    ++survey.skipped[static_cast<std::size_t>(WhySkipped(batch, i))];
    return;
  }
  survey.area.Add(triangle->area());
  survey.surface.Add(triangle->hash());
  ++survey.usable;
  for (int v = 0; v < 3; ++v) survey.bounds.Add(batch.corner(i, v));
}

Result<Survey> SurveyMesh(MeshReader& reader, std::size_t batch_size, RunContext& context) {
  tbb::enumerable_thread_specific<Survey> parts;
  auto read = ForEachBatch(reader, batch_size, context, [&](const TriangleBatch& batch) {
    Survey& part = parts.local();
    for (std::size_t i = 0; i < batch.size(); ++i) AddTriangle(batch, i, part);
    context.AddTriangles(batch.size());
    return Result<void>();
  });
  if (!read) return Forward(read);
  Survey whole;
  for (const Survey& part : parts) whole.Add(part);
  return whole;
}

Result<void> CheckSurvey(const Survey& survey, const SampleStats& stats, bool strict) {
  if (survey.usable == 0) {
    return Fail(ErrorCode::kEmptySurface, "no triangle of positive area among " +
                                              std::to_string(stats.read.triangles) + " triangles");
  }
  for (std::size_t r = 0; strict && r < stats.skipped.size(); ++r) {
    if (stats.skipped[r] == 0) continue;
    return Fail(ErrorCode::kCorruptInput, std::to_string(stats.skipped[r]) +
                                              " triangles skipped: " + kSkipReasonNames[r] +
                                              "; --strict wants every triangle to count");
  }
  return {};
}

// Cells must have coordinates.
Result<void> CheckReach(const Bounds& bounds, const Lattice& lattice) {
  for (const Vec3& corner : {bounds.min, bounds.max}) {
    const Vec3 from = corner - lattice.origin;
    for (int a = 0; a < 3; ++a) {
      if (std::fabs(from[a]) <= kMaxCellCoordinate * lattice.edge) continue;
      return Fail(ErrorCode::kOverBudget,
                  "the surface reaches more than 2^30 cells from the lattice's origin; use a "
                  "coarser lattice");
    }
  }
  return {};
}

// --- The samples, band of time after band of time ------------------------------------------------

struct UniformJob {
  std::uint64_t count, seed;
  AttributeSet attributes;
  int threads;
  std::size_t batch_size;
  Lattice lattice;
  double mesh_area;
};

class BandDrawer {
 public:
  BandDrawer(const UniformJob& job, UniformBand& band, const RunContext& context)
      : job_(job), band_(band), context_(context) {}

  Result<void> Draw(const TriangleBatch& batch) const {
    Outbox outbox(band_);
    for (std::size_t i = 0; i < batch.size(); ++i) {
      const auto triangle = TriangleArrivals::Of(batch, i);
      if (!triangle || triangle->IsQuietUntil(job_.seed, band_.end())) continue;
      const std::uint64_t first = triangle->WindowAt(band_.begin());
      const std::uint64_t last = triangle->WindowsUntil(band_.end());
      if (last - first > kSharedWindows) {
        DrawShared(*triangle, first, last, outbox);
      } else {
        DrawWindows(*triangle, first, last, outbox);
      }
      if (!outbox.status()) break;
    }
    outbox.Flush();
    return outbox.status();
  }

 private:
  // Arrivals on their way to the band.
  class Outbox {
   public:
    explicit Outbox(UniformBand& band) : band_(band) {}
    void Put(const UniformArrival& arrival) {
      arrivals_.push_back(arrival);
      if (arrivals_.size() == UniformBand::kMostAtOnce) Flush();
    }
    void Flush() {
      if (status_ && !arrivals_.empty()) status_ = band_.Add(arrivals_);
      arrivals_.clear();
    }
    void Note(const Result<void>& status) {
      if (status_) status_ = status;
    }
    const Result<void>& status() const { return status_; }

   private:
    UniformBand& band_;
    std::vector<UniformArrival> arrivals_;
    Result<void> status_;
  };

  // A few windows at a time, so that an end that was brought forward saves what lies beyond it.
  void DrawWindows(const TriangleArrivals& triangle, std::uint64_t first, std::uint64_t last,
                   Outbox& outbox) const {
    constexpr std::uint64_t kStep = 64;
    while (first < last && outbox.status() && !context_.cancelled()) {
      const std::uint64_t next = std::min(first + kStep, last);
      triangle.Visit(job_.seed, first, next, band_.begin(), band_.end(),
                     [&](const UniformArrival& arrival) { outbox.Put(arrival); });
      first = next;
      last = std::min(last, triangle.WindowsUntil(band_.end()));
    }
  }

  void DrawShared(const TriangleArrivals& triangle, std::uint64_t first, std::uint64_t last,
                  Outbox& outbox) const {
    tbb::enumerable_thread_specific<Outbox> outboxes([&] { return Outbox(band_); });
    // Isolated: a thread that waits here must not take up another batch on top of this one.
    tbb::this_task_arena::isolate([&] {
      tbb::parallel_for(tbb::blocked_range<std::uint64_t>(first, last, kSharedWindows),
                        [&](const tbb::blocked_range<std::uint64_t>& range) {
                          Outbox& own = outboxes.local();
                          DrawWindows(triangle, range.begin(), range.end(), own);
                        });
    });
    for (Outbox& each : outboxes) {
      each.Flush();
      outbox.Note(each.status());
    }
  }

  const UniformJob& job_;
  UniformBand& band_;
  const RunContext& context_;
};

class UniformSource final : public SampleSource {
 public:
  UniformSource(MeshReader& reader, const UniformJob& job, std::size_t capacity, MemoryShare share,
                RunContext& context)
      : reader_(reader),
        job_(job),
        context_(context),
        share_(std::move(share)),
        capacity_(capacity),
        band_(std::make_unique<UniformBand>(capacity)) {}

  /// Draws until there is a sample to give. Precondition: not all are given.
  Result<void> Fill() {
    while (next_ == ready_.size()) {
      if (auto drawn = DrawBand(); !drawn) return drawn;
    }
    return {};
  }

  Result<bool> Next(SampleColumns& out) override {
    if (given_ == job_.count) {
      band_.reset();
      return false;
    }
    if (auto filled = Fill(); !filled) return Forward(filled);
    const std::size_t n = static_cast<std::size_t>(
        std::min<std::uint64_t>({kSamplesAtOnce, ready_.size() - next_, job_.count - given_}));
    Give(ready_.subspan(next_, n), out);
    next_ += n;
    given_ += n;
    return true;
  }

 private:
  // How long a band is expected to hold what is wanted: nothing depends on it but the work.
  double Width(std::uint64_t wanted) const {
    const double n = static_cast<double>(wanted);
    return (n + 6 * std::sqrt(n) + 32) / job_.mesh_area * stretch_;
  }

  Result<void> DrawBand() {
    const std::uint64_t wanted =
        std::min<std::uint64_t>(job_.count - given_, std::uint64_t{capacity_} / 4 * 3);
    const double begin = end_, end = begin + Width(wanted);
    band_->Reset(begin, end);
    const BandDrawer drawer(job_, *band_, context_);
    auto drawn = InArena(job_.threads, [&] {
      auto read = ForEachBatch(reader_, job_.batch_size, context_,
                               [&](const TriangleBatch& batch) { return drawer.Draw(batch); });
      ready_ = band_->Settle();
      return read;
    });
    if (!drawn) return drawn;
    next_ = 0;
    end_ = band_->end();
    // Coincident copies are part of the area and not of the arrivals.
    if (end_ < end) {
      stretch_ = std::max(1.0, stretch_ / 2);
    } else if (ready_.size() < wanted / 2 + 1) {
      stretch_ *= 2;
    }
    return {};
  }

  void Give(std::span<const UniformArrival> arrivals, SampleColumns& out) const {
    const auto wants = [&](Attribute a) { return (job_.attributes & a) != 0; };
    const double area = job_.mesh_area / static_cast<double>(job_.count);
    out = {};
    out.position.reserve(arrivals.size());
    for (const UniformArrival& arrival : arrivals) {
      out.position.push_back(arrival.position);
      if (wants(kNormal)) out.normal.push_back(arrival.normal);
      if (wants(kTriangle)) out.triangle.push_back(arrival.triangle);
      if (wants(kBarycentric)) {
        const double b = arrival.barycentric[0], c = arrival.barycentric[1];
        out.barycentric.push_back({std::max(0.0, 1 - b - c), b, c});
      }
      if (wants(kCell)) {
        out.cell.push_back(CellAt(arrival.position, job_.lattice.origin, job_.lattice.edge));
      }
      if (wants(kArea)) out.area.push_back(area);
      if (wants(kWeight)) out.weight.push_back(1);  // As the density with lambda 0.
    }
  }

  MeshReader& reader_;
  UniformJob job_;
  RunContext& context_;
  MemoryShare share_;
  std::size_t capacity_;
  std::unique_ptr<UniformBand> band_;
  std::span<const UniformArrival> ready_;  // Of the band.
  std::size_t next_ = 0;                   // Of these.
  std::uint64_t given_ = 0;
  double end_ = 0;      // Of the band: all before it are ready or given.
  double stretch_ = 1;  // How much longer a band is than the area says.
};

// --- From options to samples ---------------------------------------------------------------------

// What the samples of the stratified method would be many.
Result<std::uint64_t> CountStratified(MeshReader& reader, SampleOptions options,
                                      RunContext& context) {
  options.method = Method::kStratified;
  options.attributes = 0;
  options.mesh_attributes.clear();
  options.vertex_normals = false;
  options.parcel_cells = 0;
  const auto sampled = SampleMeshStreamed(reader, options, context);
  if (!sampled) return Forward(sampled);
  return sampled->stats.survivors;
}

// The batches of a pass get an eighth of what is left.
std::size_t BatchSizeFor(const SampleOptions& options, const MemoryAccount& memory) {
  if (!memory.limited()) return options.batch_size;
  const auto tokens = 2 * static_cast<std::uint64_t>(
                              InArena(options.threads, tbb::this_task_arena::max_concurrency));
  const std::uint64_t fits = memory.left() / 8 / tokens / kBatchTriangleBytes;
  return static_cast<std::size_t>(std::clamp<std::uint64_t>(fits, 1, options.batch_size));
}

// As many arrivals as all samples need, or as fit a third of what is left.
std::size_t CapacityFor(std::uint64_t count, const MemoryAccount& memory) {
  const double n = static_cast<double>(count);
  const double all = (n + 12 * std::sqrt(n) + 64) / 0.75 + UniformBand::kMostAtOnce;
  std::uint64_t most = kMostCapacity;
  if (memory.limited()) most = std::min(most, memory.left() / 3 / sizeof(UniformArrival));
  const std::uint64_t capacity =
      all < static_cast<double>(most) ? static_cast<std::uint64_t>(all) : most;
  return static_cast<std::size_t>(std::max<std::uint64_t>(capacity, UniformBand::kLeastCapacity));
}

Result<SampleStats> Prepare(MeshReader& reader, const SampleOptions& options,
                            std::size_t batch_size, RunContext& context) {
  const Stopwatch watch;
  context.SetStage(RunContext::Stage::kScan);
  const auto survey =
      InArena(options.threads, [&] { return SurveyMesh(reader, batch_size, context); });
  if (!survey) return Forward(survey);
  SampleStats stats;
  stats.read = reader.counts();
  for (std::size_t r = 0; r < stats.skipped.size(); ++r) {
    stats.skipped[r] = survey->skipped[r] + stats.read.skipped[r];
  }
  if (auto checked = CheckSurvey(*survey, stats, options.strict); !checked) return Forward(checked);
  stats.sampled = survey->usable;
  stats.bounds = survey->bounds;
  stats.mesh_area = survey->area.value();
  stats.surface_hash = HexOf(survey->surface);
  auto lattice = FindLattice(reader, options.lattice, stats.bounds, stats.passes, context);
  if (!lattice) return Forward(lattice);
  stats.lattice = *lattice;
  if (auto checked = CheckReach(stats.bounds, *lattice); !checked) return Forward(checked);
  stats.lattice_seconds = watch.seconds();
  return stats;
}

}  // namespace

Result<SampledMesh> SampleUniform(MeshReader& reader, const SampleOptions& options,
                                  RunContext& context) {
  if (auto valid = CheckOptions(options); !valid) return Forward(valid);
  std::uint64_t count = options.count;
  if (count == 0) {
    const auto counted = CountStratified(reader, options, context);
    if (!counted) return Forward(counted);
    count = *counted;
    ReturnFreedMemory();
  }
  reader.SelectShare({});
  const std::size_t batch_size = BatchSizeFor(options, context.memory());
  auto stats = Prepare(reader, options, batch_size, context);
  if (!stats) return Forward(stats);
  const Stopwatch watch;
  const std::size_t capacity = CapacityFor(count, context.memory());
  auto share = context.memory().Take(capacity * sizeof(UniformArrival), "a band of samples");
  if (!share) return Forward(share);
  const UniformJob job = {count,      options.seed,   options.attributes, options.threads,
                          batch_size, stats->lattice, stats->mesh_area};
  auto source = std::make_unique<UniformSource>(reader, job, capacity, std::move(*share), context);
  if (auto filled = source->Fill(); !filled) return Forward(filled);
  ++stats->passes;
  stats->scan_seconds = watch.seconds();
  stats->survivors = count;
  const Bounds bounds = stats->bounds;
  return SampledMesh{*std::move(stats), bounds, {}, {}, std::move(source)};
}

}  // namespace strata
