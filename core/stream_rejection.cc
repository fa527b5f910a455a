#include "core/stream_rejection.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "core/numeric.h"
#include "core/rejection.h"

namespace strata {
namespace {

// Bytes a sample of the window takes while it is worked on: itself, the spatial hash, and the pairs
// and edges of the conflict graph, which grow with the samples within the distance.
std::uint64_t WindowBytesPerSample(double min_distance) {
  const double neighbours = std::ceil(kPi * min_distance * min_distance);
  return 160 + static_cast<std::uint64_t>(neighbours) * 40;
}

// Samples that are not settled yet.
struct Window {
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;
  std::vector<std::uint64_t> number;
  // What each stands for, and what of that was its own; empty where areas are not wanted.
  std::vector<FixedArea> area, own;

  std::size_t size() const { return position.size(); }
  // Keeps the samples whose fate is kOpen.
  void Keep(const std::vector<std::uint8_t>& fate) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < size(); ++i) {
      if (fate[i] != kOpenSample) continue;
      position[kept] = position[i];
      time[kept] = time[i];
      cell[kept] = cell[i];
      number[kept] = number[i];
      if (!area.empty()) area[kept] = area[i], own[kept] = own[i];
      ++kept;
    }
    position.resize(kept);
    time.resize(kept);
    cell.resize(kept);
    number.resize(kept);
    if (!area.empty()) area.resize(kept), own.resize(kept);
  }
};

class StreamJob {
 public:
  StreamJob(const StreamedBlocks& blocks, const GatherOptions& options, std::uint64_t window_bytes,
            RunContext& context)
      : blocks_(blocks.places),
        territory_(blocks.territory),
        options_(options),
        context_(context),
        distance_(options.min_distance * options.lattice.edge),
        bytes_per_sample_(WindowBytesPerSample(options.min_distance)),
        room_(std::max<std::uint64_t>(window_bytes / bytes_per_sample_, 1024)),
        samples_(blocks.samples),
        survivors_(blocks.samples) {}

  Result<Survivors> Run(BlockStream& stream) {
    if (auto ready = PrepareHeirs(); !ready) return Forward(ready);
    BlockReservoirs block;
    std::size_t wait_until = Target();
    for (;;) {
      const auto more = stream.Next(block);
      if (!more) return Forward(more);
      if (!*more) break;
      Take(block);
      if (window_.size() < wait_until) continue;
      if (auto settled = Settle(); !settled) return Forward(settled);
      wait_until = Target();
      if (wait_until > room_) return TooSmall();
    }
    if (auto settled = Settle(); !settled) return Forward(settled);
    NoteUndecided();
    if (heirs_ != nullptr) {
      if (auto sorted = heirs_->Sort(); !sorted) return Forward(sorted);
      survivors_.SetHeirs(std::move(heirs_));
    }
    return std::move(survivors_);
  }

 private:
  // Settles again once the window has grown by half of its room, or by what it holds already: so
  // the work stays proportional to the samples.
  std::size_t Target() const {
    return window_.size() + std::max<std::size_t>(room_ / 2, window_.size() / 2);
  }

  bool wants_areas() const { return (options_.attributes & kArea) != 0; }

  Result<void> PrepareHeirs() {
    if (!wants_areas()) return {};
    constexpr std::uint64_t kMost = std::uint64_t{64} << 20;
    const std::uint64_t left = context_.memory().left();
    auto heirs = Heirs::Open(std::clamp(left / 16, ExternalSort::kLeastBytes, kMost), context_);
    if (!heirs) return Forward(heirs);
    heirs_ = std::move(*heirs);
    return {};
  }

  void Take(const BlockReservoirs& block) {
    ++blocks_read_;
    for (const BlockReservoirs::Entry& entry : block.cells) {
      const Cell cell = CellOf(block.block, entry.offset);
      window_.position.push_back(PositionOf(options_, cell, entry.reservoir));
      window_.time.push_back(entry.reservoir.time);
      window_.cell.push_back(cell);
      window_.number.push_back(taken_++);
      if (!wants_areas()) continue;
      window_.area.push_back(entry.reservoir.area);
      window_.own.push_back(entry.reservoir.area);
    }
    context_.SetProgress(taken_, samples_);
  }

  Result<void> Settle() {
    std::vector<std::uint8_t> open(window_.size());
    for (std::size_t i = 0; i < open.size(); ++i) open[i] = IsOpen(i);
    const auto fate = RejectClosePoints(
        {window_.position, window_.time, window_.cell, window_.area}, distance_, context_, open);
    if (!fate) return Forward(fate);
    for (std::size_t i = 0; i < window_.size(); ++i) {
      if ((*fate)[i] != kSurvivingSample) continue;
      if (!Owns(BlockOf(window_.cell[i]))) continue;
      survivors_.Add(window_.number[i]);
      survivors_.bounds.Add(window_.position[i]);
      ++survivors_.count;
      if (!wants_areas() || window_.area[i] == window_.own[i]) continue;
      auto noted = heirs_->Add(window_.number[i], window_.area[i]);
      if (!noted) return noted;
    }
    window_.Keep(*fate);
    return {};
  }

  bool Owns(Cell block) const { return territory_ == nullptr || territory_->Owns(block); }

  void NoteUndecided() {
    for (const Cell cell : window_.cell) {
      const Cell block = BlockOf(cell);
      auto& list = survivors_.undecided;
      if ((list.empty() || list.back() != block) && Owns(block)) list.push_back(block);
    }
  }

  // Whether a sample in a block that is still to come, or never will, may be too close.
  bool IsOpen(std::size_t i) const {
    const bool all_read = blocks_read_ == blocks_.size();
    if (all_read && territory_ == nullptr) return false;
    if (options_.samples_leave_cells) {
      return !all_read || territory_->IsNearBeyond(BlockOf(window_.cell[i]));
    }
    const Cell block = BlockOf(window_.cell[i]);
    // In cells, from the block's lowest corner. The last digits leave room for rounding. The
    // distance is at most four cells: it reaches into neighbouring blocks only.
    const Vec3 at = (window_.position[i] - options_.lattice.origin) * (1 / options_.lattice.edge) -
                    Vec3{block.x * 8.0, block.y * 8.0, block.z * 8.0};
    const double reach = options_.min_distance * (1 + 1e-9) + 1e-6;
    const auto reaches = [&](double v, int step) {
      return step == 0 || (step < 0 ? v < reach : v > 8 - reach);
    };
    for (int x = -1; x <= 1; ++x) {
      for (int y = -1; y <= 1; ++y) {
        for (int z = -1; z <= 1; ++z) {
          if (!reaches(at.x, x) || !reaches(at.y, y) || !reaches(at.z, z)) continue;
          if (IsToCome({block.x + x, block.y + y, block.z + z})) return true;
        }
      }
    }
    return false;
  }
  bool IsToCome(Cell block) const {
    const auto rest = blocks_.subspan(blocks_read_);
    if (!rest.empty() && block >= rest.front() &&
        std::binary_search(rest.begin(), rest.end(), block)) {
      return true;
    }
    return territory_ != nullptr && territory_->IsBeyond(block);
  }

  tl::unexpected<Error> TooSmall() const {
    return Fail(ErrorCode::kOverBudget, "the minimum distance ties " +
                                            std::to_string(window_.size()) +
                                            " samples together, which need at least " +
                                            std::to_string(2 * window_.size() * bytes_per_sample_) +
                                            " bytes of the memory budget at a time; " +
                                            std::to_string(room_ * bytes_per_sample_) +
                                            " are left; use more memory or a smaller distance");
  }

  std::span<const Cell> blocks_;
  const Territory* territory_;
  const GatherOptions& options_;
  RunContext& context_;
  double distance_;
  std::uint64_t bytes_per_sample_, room_, samples_;
  std::uint64_t taken_ = 0;
  std::size_t blocks_read_ = 0;
  Window window_;
  Survivors survivors_;
  std::unique_ptr<Heirs> heirs_;  // Null where areas are not wanted.
};

}  // namespace

Result<std::unique_ptr<Heirs>> Heirs::Open(std::uint64_t memory_bytes, RunContext& context) {
  auto sorter = ExternalSort::Open(2 * sizeof(std::uint64_t), memory_bytes,
                                   "the areas that removed samples leave", context);
  if (!sorter) return Forward(sorter);
  return std::unique_ptr<Heirs>(new Heirs(std::move(*sorter)));
}

Result<void> Heirs::Add(std::uint64_t number, FixedArea area) {
  const std::uint64_t record[2] = {number, area};
  return sorted_->Add(reinterpret_cast<const char*>(record));
}

Result<void> Heirs::Sort() { return sorted_->Sort(); }

Result<FixedArea> Heirs::AreaOf(std::uint64_t number, FixedArea own) {
  if (!has_next_ && !at_end_) {
    const auto record = sorted_->Next();
    if (!record) return Forward(record);
    has_next_ = *record != nullptr;
    at_end_ = !has_next_;
    if (has_next_) std::memcpy(next_, *record, sizeof next_);
  }
  if (!has_next_ || next_[0] != number) return own;
  has_next_ = false;
  return next_[1];
}

Vec3 PositionOf(const GatherOptions& options, Cell cell, const Reservoir& reservoir) {
  const Vec3 at = Vec3{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5} + reservoir.local;
  Vec3 p = options.lattice.origin + at * options.lattice.edge;
  const Bounds& b = options.surface;
  for (int k = 0; k < 3; ++k) p[k] = std::clamp(p[k], b.min[k], b.max[k]);
  return p;
}

Result<Survivors> RejectStream(BlockStream& stream, const StreamedBlocks& blocks,
                               const GatherOptions& options, std::uint64_t window_bytes,
                               RunContext& context) {
  return StreamJob(blocks, options, window_bytes, context).Run(stream);
}

}  // namespace strata
