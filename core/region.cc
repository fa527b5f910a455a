#include "core/region.h"

#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "core/run_frame.h"
#include "core/run_index.h"

namespace strata {
namespace {

// Beyond this, a region reads everything: a few samples that lie far outside their cells.
constexpr std::uint64_t kMostSpread = 2;

// The indexes of all partials, open.
struct Indexes {
  std::vector<std::unique_ptr<RunIndex>> of_part;
  MemoryShare share;

  std::uint64_t spread() const {
    std::uint64_t most = 0;
    for (const auto& index : of_part) most = std::max(most, index->spread());
    return most;
  }
};

Result<Indexes> OpenIndexes(std::span<const Partial> parts, RunContext& context) {
  Indexes indexes;
  auto share = context.memory().Take(parts.size() * kIndexBufferBytes,
                                     "the indexes of " + std::to_string(parts.size()) + " parts");
  if (!share) return Forward(share);
  indexes.share = std::move(*share);
  const UnpackContext unpack = NewUnpackContext();
  for (const Partial& part : parts) {
    auto index = RunIndex::Open(*part.file, part.run, unpack);
    if (!index) return Forward(index);
    indexes.of_part.push_back(std::move(*index));
  }
  return indexes;
}

// What a region reads of the partials.
struct Choice {
  std::vector<std::shared_ptr<std::vector<std::uint64_t>>> frames;  // Per partial.
  std::vector<Cell> beyond;  // Blocks around that are not read, ascending.
};

// Which blocks a region reads.
struct Reads {
  bool all = false;
  NearBlocks home;    // The region and the blocks within reach.
  NearBlocks around;  // Its blocks whose components go further.

  bool Has(Cell block, int more) const {
    return all || home.Has(block, more) || around.Has(block, more);
  }
};

class RegionJob {
 public:
  RegionJob(std::span<const Partial> parts, const Region& region, const GatherOptions& options,
            RunContext& context)
      : parts_(parts), region_(region), options_(options), context_(context) {}

  Result<Gathered> Run() {
    if (auto planned = Plan(); !planned) return Forward(planned);
    if (mine_.empty()) return Gathered();
    for (int distance = reach_;; distance *= 4) {
      reads_.around = NearBlocks::Around(undecided_, distance);
      auto gathered = Gather();
      if (!gathered || gathered->undecided.empty()) return gathered;
      // What was closed before stays closed only as long as its surroundings are read again.
      const auto& more = gathered->undecided;
      undecided_.insert(undecided_.end(), more.begin(), more.end());
    }
  }

 private:
  Result<void> Plan();
  Result<Choice> Choose() const;
  Result<Gathered> Gather();

  std::span<const Partial> parts_;
  Region region_;
  GatherOptions options_;
  RunContext& context_;
  std::vector<OctreeNode> mine_;
  std::uint64_t cells_ = 0;
  // Samples of blocks farther apart cannot conflict. 0 = there is no distance to keep.
  int reach_ = 0;
  Reads reads_;
  std::vector<Cell> undecided_;  // Blocks of the region whose components leave what was read.
};

Result<void> RegionJob::Plan() {
  const auto indexes = OpenIndexes(parts_, context_);
  if (!indexes) return Forward(indexes);
  const auto visit = [&](const auto& block) -> Result<void> {
    MergedIndex merged(indexes->of_part);
    for (IndexedBlock at;;) {
      if (context_.cancelled()) return Cancelled();
      const auto more = merged.Next(at);
      if (!more) return Forward(more);
      if (!*more) return {};
      block(at.block, CellsIn(at.cells));
    }
  };
  const auto parcels =
      PlanParcels(options_.parcel_cells, options_.surface, options_.lattice.edge, visit);
  if (!parcels) return Forward(parcels);
  const auto mine = ParcelsOf(region_, *parcels);
  mine_.assign(mine.begin(), mine.end());
  for (const OctreeNode& parcel : mine_) cells_ += parcel.count;
  if (options_.min_distance > 0) {
    // The distance is at most half a block.
    reach_ = 1;
    if (options_.samples_leave_cells) {
      const std::uint64_t spread = indexes->spread();
      reads_.all = spread > kMostSpread;
      reach_ += reads_.all ? 0 : 2 * static_cast<int>(spread);
    }
  }
  reads_.home = NearBlocks(mine_, reach_);
  return {};
}

Result<Choice> RegionJob::Choose() const {
  const auto indexes = OpenIndexes(parts_, context_);
  if (!indexes) return Forward(indexes);
  Choice choice;
  for (const auto& index : indexes->of_part) {
    auto frames = std::make_shared<std::vector<std::uint64_t>>();
    for (IndexedBlock at;;) {
      if (context_.cancelled()) return Cancelled();
      const auto more = index->Next(at);
      if (!more) return Forward(more);
      if (!*more) break;
      if (reads_.Has(at.block, 0)) {
        if (frames->empty() || frames->back() != at.frame) frames->push_back(at.frame);
      } else if (reach_ > 0 && reads_.Has(at.block, reach_)) {
        choice.beyond.push_back(at.block);
      }
    }
    choice.frames.push_back(std::move(frames));
  }
  std::sort(choice.beyond.begin(), choice.beyond.end());
  choice.beyond.erase(std::unique(choice.beyond.begin(), choice.beyond.end()), choice.beyond.end());
  return choice;
}

Result<Gathered> RegionJob::Gather() {
  auto choice = Choose();
  if (!choice) return Forward(choice);
  const auto share = context_.memory().Take(choice->beyond.capacity() * sizeof(Cell),
                                            "the list of blocks around a region");
  if (!share) return Forward(share);
  StoreLimits limits;
  limits.scratch = context_.scratch();
  limits.barycentric = parts_.front().info.barycentric;
  limits.context = &context_;
  auto store = std::make_unique<ReservoirStore>(limits);
  // The store outlives this job.
  const auto reads = std::make_shared<const Reads>(reads_);
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    if (choice->frames[p]->empty()) continue;
    store->Adopt({parts_[p].file, parts_[p].run, choice->frames[p],
                  [reads](Cell block) { return reads->Has(block, 0); }});
  }
  auto territory = std::make_unique<Territory>(mine_, std::move(choice->beyond), reach_);
  auto gathered = GatherInPasses(std::move(store), options_, context_, std::move(territory));
  if (gathered && gathered->cells != cells_) {
    return Fail(ErrorCode::kCorruptInput,
                parts_.front().file->name() + " and the other parts hold " +
                    std::to_string(gathered->cells) + " cells of the region; their indexes say " +
                    std::to_string(cells_));
  }
  return gathered;
}

}  // namespace

Result<Gathered> GatherPartials(std::span<const Partial> parts, const Region& region,
                                const GatherOptions& options, RunContext& context) {
  return RegionJob(parts, region, options, context).Run();
}

}  // namespace strata
