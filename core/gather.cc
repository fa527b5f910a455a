#include "core/gather.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "core/held_samples.h"
#include "core/numeric.h"
#include "core/parcels.h"
#include "core/rejection.h"
#include "core/stopwatch.h"
#include "core/stream_rejection.h"

namespace strata {
namespace {

// Sums of cells' areas, whose order must not show.
class AreaSum {
 public:
  void Add(FixedArea area) { sum_ += area; }
  double InWorldUnits(const Lattice& lattice) const {
    return static_cast<double>(sum_) * kFixedAreaUnit * (lattice.edge * lattice.edge);
  }

 private:
  __extension__ unsigned __int128 sum_ = 0;
};

void Resize(SampleColumns& out, AttributeSet want, std::size_t n) {
  out.position.resize(n);
  out.normal.resize((want & kNormal) != 0 ? n : 0);
  out.triangle.resize((want & kTriangle) != 0 ? n : 0);
  out.barycentric.resize((want & kBarycentric) != 0 ? n : 0);
  out.cell.resize((want & kCell) != 0 ? n : 0);
  out.area.resize((want & kArea) != 0 ? n : 0);
  out.weight.resize((want & kWeight) != 0 ? n : 0);
}

// What becomes a sample.
struct Winner {
  Vec3 position;
  Cell cell;
  const Reservoir& reservoir;
  FixedArea area;  // What it stands for.
};

void Put(SampleColumns& out, std::size_t k, const GatherOptions& options, const Winner& winner) {
  const auto& [position, cell, r, area] = winner;
  const AttributeSet want = options.attributes;
  const double edge = options.lattice.edge;
  out.position[k] = position;
  if ((want & kNormal) != 0) out.normal[k] = r.normal;
  if ((want & kTriangle) != 0) out.triangle[k] = r.triangle;
  if ((want & kBarycentric) != 0) {
    const double b = r.barycentric[0], c = r.barycentric[1];
    out.barycentric[k] = {std::max(0.0, 1 - b - c), b, c};
  }
  if ((want & kCell) != 0) out.cell[k] = cell;
  if ((want & kArea) != 0) {
    out.area[k] = static_cast<double>(area) * (kFixedAreaUnit * edge * edge);
  }
  if ((want & kWeight) != 0) out.weight[k] = Exp(-options.lambda * Norm(r.local));
}

std::uint64_t BytesPerSample(AttributeSet attributes) {
  SampleColumns one;
  Resize(one, attributes, 1);
  return sizeof(Vec3) + one.normal.size() * sizeof(Vec3f) + one.triangle.size() * 8 +
         one.barycentric.size() * 24 + one.cell.size() * sizeof(Cell) +
         (one.area.size() + one.weight.size()) * 8;
}

// --- All at once -----------------------------------------------------------------------------

// The columns that the minimum distance looks at, of all cells in canonical order.
struct AllCells {
  explicit AllCells(std::size_t n) : reservoir(n), position(n), time(n), cell(n) {}
  std::vector<const Reservoir*> reservoir;
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;
  std::vector<FixedArea> area;  // Where it is wanted: what each stands for.
};

AllCells Collect(const ReservoirGrid& grid, const GatherOptions& options) {
  AllCells all(grid.size());
  grid.VisitInOrder([&](std::size_t i, Cell cell, const Reservoir& reservoir) {
    all.reservoir[i] = &reservoir;
    all.cell[i] = cell;
    all.time[i] = reservoir.time;
    all.position[i] = PositionOf(options, cell, reservoir);
  });
  if ((options.attributes & kArea) == 0) return all;
  all.area.reserve(grid.size());
  for (const Reservoir* r : all.reservoir) all.area.push_back(r->area);
  return all;
}

SampleColumns Keep(const AllCells& all, const std::vector<std::uint8_t>& fate,
                   const GatherOptions& options) {
  std::vector<std::size_t> kept;
  kept.reserve(fate.size());
  for (std::size_t i = 0; i < fate.size(); ++i) {
    if (fate[i] == kSurvivingSample) kept.push_back(i);
  }
  SampleColumns out;
  Resize(out, options.attributes, kept.size());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, kept.size(), 4096), [&](const auto& range) {
    for (std::size_t k = range.begin(); k != range.end(); ++k) {
      const std::size_t i = kept[k];
      Put(out, k, options,
          {all.position[i], all.cell[i], *all.reservoir[i], all.area.empty() ? 0 : all.area[i]});
    }
  });
  return out;
}

// `cells` are grouped by block.
Result<std::vector<OctreeNode>> ParcelsOfCells(const std::vector<Cell>& cells,
                                               const GatherOptions& options) {
  if (options.parcel_cells == 0) return {};
  const auto visit = [&](const auto& block) -> Result<void> {
    for (std::size_t begin = 0, end = 0; begin < cells.size(); begin = end) {
      const Cell place = BlockOf(cells[begin]);
      while (end < cells.size() && BlockOf(cells[end]) == place) ++end;
      block(place, end - begin);
    }
    return {};
  };
  return PlanParcels(options.parcel_cells, options.surface, options.lattice.edge, visit);
}

// --- In passes -------------------------------------------------------------------------------

// What the first pass finds; cells, area and bounds of the territory alone.
struct Overview {
  std::vector<Cell> blocks;
  std::vector<std::uint16_t> counts;  // Cells of each; empty where no parcels are wanted.
  MemoryShare blocks_share;
  std::uint64_t samples = 0;  // In all blocks.
  std::uint64_t cells = 0;
  AreaSum area;
  Bounds bounds;  // Of all samples.
};

constexpr std::uint64_t kSamplesAtOnce = 1 << 16;

class PassJob {
 public:
  PassJob(std::unique_ptr<ReservoirStore> store, const GatherOptions& options, RunContext& context,
          std::unique_ptr<const Territory> territory)
      : store_(std::move(store)),
        options_(options),
        context_(context),
        territory_(std::move(territory)) {}

  Result<Gathered> Run();

 private:
  Result<Overview> Survey();
  void Note(const BlockReservoirs& block, Overview& all) const;
  Result<std::vector<OctreeNode>> Parcels(Overview& overview) const;
  Result<Survivors> Reject(const Overview& overview);

  std::unique_ptr<ReservoirStore> store_;
  GatherOptions options_;
  RunContext& context_;
  std::unique_ptr<const Territory> territory_;  // Null = all blocks.
};

// The last pass: hands out what survives.
class PassSource : public SampleSource {
 public:
  PassSource(std::unique_ptr<ReservoirStore> store, std::unique_ptr<BlockStream> blocks,
             std::optional<Survivors> survivors, MemoryShare share, const GatherOptions& options,
             std::unique_ptr<const Territory> territory)
      : store_(std::move(store)),
        blocks_(std::move(blocks)),
        survivors_(std::move(survivors)),
        share_(std::move(share)),
        options_(options),
        territory_(std::move(territory)) {}

  Result<bool> Next(SampleColumns& out) override {
    Resize(out, options_.attributes, kSamplesAtOnce + 512);
    std::size_t filled = 0;
    while (filled < kSamplesAtOnce) {
      const auto more = blocks_->Next(block_);
      if (!more) return Forward(more);
      if (!*more) break;
      if (territory_ && !territory_->Owns(block_.block)) {
        number_ += block_.cells.size();
        continue;
      }
      for (const BlockReservoirs::Entry& entry : block_.cells) {
        ++number_;
        if (survivors_ && !survivors_->Has(number_ - 1)) continue;
        const Cell cell = CellOf(block_.block, entry.offset);
        const auto area = AreaOf(number_ - 1, entry.reservoir);
        if (!area) return Forward(area);
        Put(out, filled++, options_,
            {PositionOf(options_, cell, entry.reservoir), cell, entry.reservoir, *area});
      }
    }
    Resize(out, options_.attributes, filled);
    return filled > 0;
  }

 private:
  // What the sample stands for that has this number among all.
  Result<FixedArea> AreaOf(std::uint64_t number, const Reservoir& reservoir) {
    if (!survivors_ || !survivors_->heirs()) return reservoir.area;
    return survivors_->heirs()->AreaOf(number, reservoir.area);
  }

  std::unique_ptr<ReservoirStore> store_;
  std::unique_ptr<BlockStream> blocks_;
  std::optional<Survivors> survivors_;  // None = all.
  MemoryShare share_;
  GatherOptions options_;
  std::unique_ptr<const Territory> territory_;  // Null = all blocks.
  BlockReservoirs block_;
  std::uint64_t number_ = 0;
};

Result<Overview> PassJob::Survey() {
  auto stream = store_->Blocks(context_.memory());
  if (!stream) return Forward(stream);
  Overview all;
  BlockReservoirs block;
  for (;;) {
    const auto more = (*stream)->Next(block);
    if (!more) return Forward(more);
    if (!*more) break;
    if (context_.cancelled()) return Cancelled();
    Note(block, all);
  }
  const std::uint64_t bytes =
      all.blocks.capacity() * sizeof(Cell) + all.counts.capacity() * sizeof(std::uint16_t);
  auto share = context_.memory().Take(bytes, "the list of blocks");
  if (!share) return Forward(share);
  all.blocks_share = std::move(*share);
  return all;
}

void PassJob::Note(const BlockReservoirs& block, Overview& all) const {
  all.blocks.push_back(block.block);
  all.samples += block.cells.size();
  if (territory_ && !territory_->Owns(block.block)) return;
  if (!territory_ && options_.parcel_cells > 0) {
    all.counts.push_back(static_cast<std::uint16_t>(block.cells.size()));
  }
  all.cells += block.cells.size();
  for (const BlockReservoirs::Entry& entry : block.cells) {
    all.area.Add(entry.reservoir.area);
    all.bounds.Add(PositionOf(options_, CellOf(block.block, entry.offset), entry.reservoir));
  }
}

Result<std::vector<OctreeNode>> PassJob::Parcels(Overview& overview) const {
  if (territory_) return territory_->nodes();
  if (options_.parcel_cells == 0) return {};
  const auto visit = [&](const auto& block) -> Result<void> {
    for (std::size_t b = 0; b < overview.blocks.size(); ++b) {
      block(overview.blocks[b], overview.counts[b]);
    }
    return {};
  };
  return PlanParcels(options_.parcel_cells, options_.surface, options_.lattice.edge, visit);
}

Result<Survivors> PassJob::Reject(const Overview& overview) {
  auto stream = store_->Blocks(context_.memory());
  if (!stream) return Forward(stream);
  context_.SetStage(RunContext::Stage::kReject);
  return RejectStream(**stream, {overview.blocks, overview.samples, territory_.get()}, options_,
                      context_.memory().left() / 10 * 7, context_);
}

Result<Gathered> PassJob::Run() {
  auto overview = Survey();
  if (!overview) return Forward(overview);
  Gathered out;
  auto parcels = Parcels(*overview);
  if (!parcels) return Forward(parcels);
  out.parcels = std::move(*parcels);
  out.cells = out.survivors = overview->cells;
  out.cell_area = overview->area.InWorldUnits(options_.lattice);
  out.bounds = overview->bounds;
  std::optional<Survivors> survivors;
  MemoryShare share;
  const Stopwatch watch;
  if (options_.min_distance > 0) {
    auto bits =
        context_.memory().Take(Survivors::BytesFor(overview->samples), "the list of survivors");
    if (!bits) return Forward(bits);
    share = std::move(*bits);
    auto found = Reject(*overview);
    if (!found) return Forward(found);
    survivors = std::move(*found);
    out.survivors = survivors->count;
    out.bounds = survivors->bounds;
    out.undecided = survivors->undecided;
    if (!out.undecided.empty()) return out;
  }
  out.reject_seconds = watch.seconds();
  auto stream = store_->Blocks(context_.memory());
  if (!stream) return Forward(stream);
  out.samples =
      std::make_unique<PassSource>(std::move(store_), std::move(*stream), std::move(survivors),
                                   std::move(share), options_, std::move(territory_));
  return out;
}

}  // namespace

Result<Gathered> GatherInMemory(std::unique_ptr<ReservoirStore> store, const GatherOptions& options,
                                RunContext& context) {
  AllCells all = Collect(store->grid(), options);
  Gathered out;
  out.cells = all.cell.size();
  AreaSum area;
  for (const Reservoir* r : all.reservoir) area.Add(r->area);
  out.cell_area = area.InWorldUnits(options.lattice);
  auto parcels = ParcelsOfCells(all.cell, options);
  if (!parcels) return Forward(parcels);
  out.parcels = std::move(*parcels);
  context.SetStage(RunContext::Stage::kReject);
  const Stopwatch watch;
  const auto fate = RejectClosePoints({all.position, all.time, all.cell, all.area},
                                      options.min_distance * options.lattice.edge, context);
  if (!fate) return Forward(fate);
  out.reject_seconds = watch.seconds();
  SampleColumns samples = Keep(all, *fate, options);
  out.survivors = samples.size();
  for (const Vec3& p : samples.position) out.bounds.Add(p);
  auto share =
      context.memory().Take(samples.size() * BytesPerSample(options.attributes), "samples");
  if (!share) return Forward(share);
  out.samples = std::make_unique<HeldSamples>(std::move(samples), std::move(*share));
  return out;
}

Result<Gathered> GatherInPasses(std::unique_ptr<ReservoirStore> store, const GatherOptions& options,
                                RunContext& context, std::unique_ptr<const Territory> territory) {
  return PassJob(std::move(store), options, context, std::move(territory)).Run();
}

}  // namespace strata
