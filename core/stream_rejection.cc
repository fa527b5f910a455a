#include "core/stream_rejection.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "core/numeric.h"
#include "core/rejection.h"

namespace strata {
namespace {

// Bytes a sample of the window takes while it is worked on: itself, the spatial hash, and the pairs
// and edges of the conflict graph, which grow with the samples within the distance.
std::uint64_t WindowBytesPerSample(double min_distance) {
  const double neighbours = std::ceil(kPi * min_distance * min_distance);
  return 140 + static_cast<std::uint64_t>(neighbours) * 40;
}

// Samples that are not settled yet.
struct Window {
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;
  std::vector<std::uint64_t> number;

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
      ++kept;
    }
    position.resize(kept);
    time.resize(kept);
    cell.resize(kept);
    number.resize(kept);
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
    return std::move(survivors_);
  }

 private:
  // Settles again once the window has grown by half of its room, or by what it holds already: so
  // the work stays proportional to the samples.
  std::size_t Target() const {
    return window_.size() + std::max<std::size_t>(room_ / 2, window_.size() / 2);
  }

  void Take(const BlockReservoirs& block) {
    ++blocks_read_;
    for (const BlockReservoirs::Entry& entry : block.cells) {
      const Cell cell = CellOf(block.block, entry.offset);
      window_.position.push_back(PositionOf(options_, cell, entry.reservoir));
      window_.time.push_back(entry.reservoir.time);
      window_.cell.push_back(cell);
      window_.number.push_back(taken_++);
    }
    context_.SetProgress(taken_, samples_);
  }

  Result<void> Settle() {
    std::vector<std::uint8_t> open(window_.size());
    for (std::size_t i = 0; i < open.size(); ++i) open[i] = IsOpen(i);
    const auto fate = RejectClosePoints({window_.position, window_.time, window_.cell}, distance_,
                                        context_, open);
    if (!fate) return Forward(fate);
    for (std::size_t i = 0; i < window_.size(); ++i) {
      if ((*fate)[i] != kSurvivingSample) continue;
      if (!Owns(BlockOf(window_.cell[i]))) continue;
      survivors_.Add(window_.number[i]);
      survivors_.bounds.Add(window_.position[i]);
      ++survivors_.count;
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
};

}  // namespace

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
