#include "core/block_merge.h"

#include <algorithm>
#include <utility>

namespace strata {

BlockMerge::BlockMerge(std::vector<std::unique_ptr<BlockStream>> streams)
    : streams_(std::move(streams)), front_(streams_.size()) {}

Result<void> BlockMerge::Advance(std::size_t stream) {
  const auto more = streams_[stream]->Next(front_[stream]);
  if (!more) return Forward(more);
  if (!*more) {
    streams_[stream].reset();
    front_[stream].cells = {};
    return {};
  }
  heap_.push_back(stream);
  std::push_heap(heap_.begin(), heap_.end(),
                 [&](std::size_t a, std::size_t b) { return front_[b].block < front_[a].block; });
  return {};
}

Result<bool> BlockMerge::Next(BlockReservoirs& out) {
  for (std::size_t s = 0; !started_ && s < streams_.size(); ++s) {
    if (auto advanced = Advance(s); !advanced) return Forward(advanced);
  }
  started_ = true;
  if (heap_.empty()) return false;
  const auto later = [&](std::size_t a, std::size_t b) {
    return front_[b].block < front_[a].block;
  };
  for (bool first = true; !heap_.empty(); first = false) {
    const std::size_t stream = heap_.front();
    if (!first && front_[stream].block != out.block) break;
    std::pop_heap(heap_.begin(), heap_.end(), later);
    heap_.pop_back();
    if (first) {
      std::swap(out, front_[stream]);
    } else {
      out.Merge(front_[stream]);
    }
    if (auto advanced = Advance(stream); !advanced) return Forward(advanced);
  }
  return true;
}

}  // namespace strata
