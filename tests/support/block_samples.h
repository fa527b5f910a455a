// Samples in cells and blocks, made up without a mesh, for tests of the minimum distance.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "core/block.h"
#include "core/gather.h"
#include "core/rejection.h"
#include "core/stream_rejection.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {

class VectorStream : public BlockStream {
 public:
  explicit VectorStream(const std::vector<BlockReservoirs>& blocks) : blocks_(blocks) {}
  Result<bool> Next(BlockReservoirs& out) override {
    if (next_ == blocks_.size()) return false;
    out = blocks_[next_++];
    return true;
  }

 private:
  const std::vector<BlockReservoirs>& blocks_;
  std::size_t next_ = 0;
};

// One sample in each of many cells.
struct Samples {
  std::vector<BlockReservoirs> blocks;
  std::vector<Cell> places;
  std::uint64_t count = 0;

  explicit Samples(const std::map<Cell, Reservoir>& cells) {
    std::map<Cell, BlockReservoirs> all;
    for (const auto& [cell, reservoir] : cells) {
      BlockReservoirs& block = all[BlockOf(cell)];
      block.block = BlockOf(cell);
      block.cells.push_back({OffsetInBlock(cell), reservoir});
      ++count;
    }
    for (auto& [place, block] : all) {
      places.push_back(place);
      blocks.push_back(std::move(block));
    }
  }
};

// A sheet of cells: `tilt` 0 lies across the first axis, so that all blocks share it.
inline std::map<Cell, Reservoir> Sheet(int side, int tilt, TestRandom& random) {
  std::map<Cell, Reservoir> cells;
  for (int i = 0; i < side; ++i) {
    for (int j = 0; j < side; ++j) {
      if (random.Unit() < 0.1) continue;
      const Cell cell{tilt == 0 ? 3 : i / tilt - side / 2, i - side / 3, j - side / 2};
      Reservoir& r = cells[cell];
      r.time = random.Below(5) == 0 ? 0.5 : random.Unit();
      r.local = random.InBox({-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5});
    }
  }
  return cells;
}

// What the minimum distance leaves of all samples, decided at once.
inline std::vector<std::uint8_t> AtOnce(const Samples& samples, const GatherOptions& options) {
  std::vector<Vec3> position;
  std::vector<double> time;
  std::vector<Cell> cell;
  for (const BlockReservoirs& block : samples.blocks) {
    for (const auto& [offset, r] : block.cells) {
      cell.push_back(CellOf(block.block, offset));
      time.push_back(r.time);
      position.push_back(PositionOf(options, cell.back(), r));
    }
  }
  RunContext context;
  return *RejectClosePoints({position, time, cell}, options.min_distance * options.lattice.edge,
                            context);
}

}  // namespace strata::test
