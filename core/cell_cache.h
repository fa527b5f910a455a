// A worker's own reservoirs: small, private, and emptied into the grid when full.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/random_stream.h"
#include "core/reservoir.h"
#include "core/vec3.h"

namespace strata {

/// What every triangle of a cell needs: half a cache line. The sample stands elsewhere.
struct LiveCell {
  Cell cell;
  std::uint32_t favourite = 0;  ///< For the scan: its likeliest contender.
  double time = std::numeric_limits<double>::infinity();  ///< Of the best arrival so far.
  FixedArea area = 0;
};

/// Where a cell's search begins. The vector kernel computes it for many cells at once.
inline std::uint32_t HashCell(Cell cell) {
  return static_cast<std::uint32_t>(CellOffset(cell) >> 32);
}

/// Open-addressing map from cell to reservoir. Threads: one.
class CellCache {
 public:
  /// Room for `capacity` cells; about 140 bytes each, used as cells come.
  explicit CellCache(std::size_t capacity) : capacity_(capacity), index_(kFirstSlots, 0) {
    live_.reserve(capacity);
    best_.reserve(capacity);
  }

  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

  /// What loops over many cells keep in registers. Valid until Add or Clear.
  struct View {
    const std::uint32_t* index;
    std::uint32_t mask;
    LiveCell* live;

    /// The entry of `cell` (with hash HashCell(cell)), kNone if it has none.
    [[gnu::always_inline]] std::uint32_t Find(Cell cell, std::uint32_t hash) const {
      for (std::uint32_t i = hash & mask; index[i] != 0; i = (i + 1) & mask) {
        const std::uint32_t entry = index[i] - 1;
        if (live[entry].cell == cell) return entry;
      }
      return kNone;
    }
  };
  View view() {
    return {index_.data(), static_cast<std::uint32_t>(index_.size() - 1), live_.data()};
  }

  std::size_t size() const { return live_.size(); }
  bool full() const { return live_.size() == capacity_; }
  LiveCell& live(std::size_t entry) { return live_[entry]; }
  const LiveCell& live(std::size_t entry) const { return live_[entry]; }
  /// The best sample; its `time` and `area` are those of `live`, once Seal has been called.
  Reservoir& best(std::size_t entry) { return best_[entry]; }
  const Reservoir& best(std::size_t entry) const { return best_[entry]; }

  /// A new entry for `cell`, empty. Precondition: it has none, and !full().
  std::uint32_t Add(Cell cell, std::uint32_t hash) {
    if (4 * (live_.size() + 1) > index_.size()) Grow();
    live_.emplace_back().cell = cell;
    best_.emplace_back();
    Enter(hash, static_cast<std::uint32_t>(live_.size()));
    return static_cast<std::uint32_t>(live_.size() - 1);
  }

  /// Copies times and areas beside the samples.
  void Seal() {
    for (std::size_t i = 0; i < live_.size(); ++i) {
      best_[i].time = live_[i].time;
      best_[i].area = live_[i].area;
    }
  }

  void Clear() {
    live_.clear();
    best_.clear();
    index_.assign(index_.size(), 0);
  }

 private:
  static constexpr std::size_t kFirstSlots = 1024;

  void Enter(std::uint32_t hash, std::uint32_t value) {
    std::size_t i = hash & (index_.size() - 1);
    while (index_[i] != 0) i = (i + 1) & (index_.size() - 1);
    index_[i] = value;
  }
  void Grow() {
    index_.assign(2 * index_.size(), 0);
    for (std::uint32_t entry = 0; entry < live_.size(); ++entry) {
      Enter(HashCell(live_[entry].cell), entry + 1);
    }
  }

  std::size_t capacity_;
  std::vector<std::uint32_t> index_;  // 0 = free, else entry number + 1.
  std::vector<LiveCell> live_;
  std::vector<Reservoir> best_;
};

}  // namespace strata
