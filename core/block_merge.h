// Several streams of blocks as one.
#pragma once

#include <memory>
#include <vector>

#include "core/block.h"

namespace strata {

/// Merges streams of blocks; blocks with the same place become one. The order of the streams does
/// not show in the result. Memory: a block and a heap entry a stream, beside the streams' own.
class BlockMerge : public BlockStream {
 public:
  explicit BlockMerge(std::vector<std::unique_ptr<BlockStream>> streams);
  Result<bool> Next(BlockReservoirs& out) override;

 private:
  Result<void> Advance(std::size_t stream);

  std::vector<std::unique_ptr<BlockStream>> streams_;
  std::vector<BlockReservoirs> front_;  // Per stream.
  std::vector<std::size_t> heap_;       // Streams by their front block, the lowest first.
  bool started_ = false;
};

}  // namespace strata
