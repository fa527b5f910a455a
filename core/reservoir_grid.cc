#include "core/reservoir_grid.h"

#include <openvdb/version.h>
// Leaves are never read from files here. Without delayed loading (which upstream is removing) a
// leaf needs nothing of the shared library.
#undef OPENVDB_USE_DELAYED_LOADING
#include <openvdb/tree/InternalNode.h>
#include <openvdb/tree/LeafNode.h>
#include <openvdb/tree/RootNode.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

namespace strata {
namespace {

constexpr std::size_t kShards = 32;

constexpr std::uint32_t kNoSlot = 0xffffffff;

// Leaves of 8^3 cells below nodes of 32^3; values are slot numbers, 4 bytes each (an OpenVDB value
// above 8 bytes makes nodes of megabytes). A shard has every 32nd block of a neighbourhood, so
// nodes of the usual 128^3, 34 KB each, would be empty pointers but for a few. The root is a sorted
// map, so far-apart parts cost nothing. The root node itself, not openvdb::Tree around it: Tree's
// virtual functions for files would pull in the shared library, whose relocations take longer than
// sampling a small mesh (docs/adr/0005).
struct Slot {  // A type of our own, so that no instantiation is shared with the library's.
  std::uint32_t number = kNoSlot;
  Slot() = default;
  explicit Slot(std::uint32_t n) : number(n) {}  // OpenVDB's zeroVal<T>() calls T(0).
  bool operator==(const Slot&) const = default;
};
using Leaf = openvdb::tree::LeafNode<Slot, 3>;
using Branch = openvdb::tree::InternalNode<Leaf, 2>;
using SlotTree = openvdb::tree::RootNode<Branch>;

openvdb::Coord ToCoord(Cell c) { return {c.x, c.y, c.z}; }
std::size_t ShardOf(Cell c) {
  const Cell b = BlockOf(c);
  std::uint64_t h = static_cast<std::uint32_t>(b.x) * 0x9e3779b97f4a7c15ULL;
  h = (h ^ static_cast<std::uint32_t>(b.y)) * 0xbb67ae8584caa73bULL;
  h = (h ^ (h >> 32) ^ static_cast<std::uint32_t>(b.z)) * 0x9e3779b97f4a7c15ULL;
  return h >> 59;
}
static_assert(kShards == 1u << (64 - 59));

// Reservoirs in pieces of fixed size: growing never moves them.
class SlotArray {
 public:
  std::size_t size() const { return size_; }
  std::uint64_t bytes() const { return chunks_.size() * sizeof(Reservoir) * (kMask + 1); }
  Reservoir& operator[](std::size_t i) { return chunks_[i >> kBits][i & kMask]; }
  const Reservoir& operator[](std::size_t i) const { return chunks_[i >> kBits][i & kMask]; }
  std::uint32_t Push(const Reservoir& r) {
    if ((size_ & kMask) == 0) chunks_.push_back(std::make_unique<Reservoir[]>(kMask + 1));
    (*this)[size_] = r;
    return static_cast<std::uint32_t>(size_++);
  }

 private:
  static constexpr std::size_t kBits = 8, kMask = (1u << kBits) - 1;
  std::vector<std::unique_ptr<Reservoir[]>> chunks_;
  std::size_t size_ = 0;
};

}  // namespace

struct ReservoirGrid::Shard {
  Shard() : tree(Slot{}) {}
  // One tree and one reused accessor, both behind the mutex.
  std::mutex mutex;
  SlotTree tree;
  SlotArray slots;

  struct Growth {
    std::size_t cells;
    std::uint64_t bytes;
  };
  // Returns what came in new.
  Growth Merge(const CellCache& cache, std::span<const std::uint32_t> chosen) {
    const std::lock_guard<std::mutex> lock(mutex);
    const std::size_t cells_before = slots.size();
    const std::uint64_t bytes_before = bytes();
    Cell block{};
    Leaf* leaf = nullptr;
    for (const std::uint32_t number : chosen) {
      const Cell cell = cache.live(number).cell;
      if (leaf == nullptr || BlockOf(cell) != block) {
        block = BlockOf(cell);
        leaf = tree.touchLeaf(ToCoord(cell));
        leaves += leaf->isEmpty();
      }
      const openvdb::Index at = Leaf::coordToOffset(ToCoord(cell));
      const std::uint32_t slot = leaf->getValue(at).number;
      if (slot == kNoSlot) {
        leaf->setValueOn(at, Slot{slots.Push(cache.best(number))});
      } else {
        slots[slot].Merge(cache.best(number));
      }
    }
    return {slots.size() - cells_before, bytes() - bytes_before};
  }

  std::uint64_t bytes() const {
    return slots.bytes() + leaves * (sizeof(Leaf) + kAllocation) +
           tree.getTableSize() * (sizeof(Branch) + kAllocation + kRootEntry);
  }
  static constexpr std::uint64_t kAllocation = 32;  // What the allocator adds.
  static constexpr std::uint64_t kRootEntry = 96;   // A node of the root's map.
  std::uint64_t leaves = 0;
};

ReservoirGrid::ReservoirGrid() : shards_(std::make_unique<Shard[]>(kShards)) {}
ReservoirGrid::~ReservoirGrid() = default;

void ReservoirGrid::Merge(const CellCache& cache) {
  // Counting sort of entry numbers by shard keeps each shard's entries in file order, which is
  // mostly block order, and takes each lock once.
  std::array<std::size_t, kShards + 1> begin{};
  std::vector<std::uint8_t> shard(cache.size());
  for (std::size_t i = 0; i < cache.size(); ++i) {
    shard[i] = static_cast<std::uint8_t>(ShardOf(cache.live(i).cell));
    ++begin[shard[i] + 1u];
  }
  for (std::size_t s = 0; s < kShards; ++s) begin[s + 1] += begin[s];
  std::vector<std::uint32_t> order(cache.size());
  auto next = begin;
  for (std::uint32_t i = 0; i < cache.size(); ++i) order[next[shard[i]]++] = i;
  for (std::size_t s = 0; s < kShards; ++s) {
    if (begin[s] == begin[s + 1]) continue;
    const Shard::Growth growth =
        shards_[s].Merge(cache, {order.data() + begin[s], begin[s + 1] - begin[s]});
    size_ += growth.cells;
    bytes_ += growth.bytes;
  }
}

struct ReservoirGrid::LeafPlace {
  Cell block;
  const Leaf* leaf;
  const SlotArray* slots;
};

// In no order.
std::vector<ReservoirGrid::LeafPlace> ReservoirGrid::Leaves() const {
  std::vector<LeafPlace> leaves;
  for (std::size_t s = 0; s < kShards; ++s) {
    for (auto branch = shards_[s].tree.cbeginChildOn(); branch; ++branch) {
      for (auto leaf = branch->cbeginChildOn(); leaf; ++leaf) {
        const openvdb::Coord& o = leaf->origin();
        leaves.push_back({BlockOf({o.x(), o.y(), o.z()}), &*leaf, &shards_[s].slots});
      }
    }
  }
  return leaves;
}

void ReservoirGrid::VisitInOrder(const Visitor& visit) const {
  std::vector<LeafPlace> leaves = Leaves();
  tbb::parallel_sort(leaves.begin(), leaves.end(),
                     [](const LeafPlace& a, const LeafPlace& b) { return a.block < b.block; });
  std::vector<std::size_t> first(leaves.size());
  std::size_t position = 0;
  for (std::size_t i = 0; i < leaves.size(); ++i) {
    first[i] = position;
    position += leaves[i].leaf->onVoxelCount();
  }
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, leaves.size(), 16), [&](const auto& range) {
    for (std::size_t i = range.begin(); i != range.end(); ++i) {
      std::size_t at = first[i];
      for (auto value = leaves[i].leaf->cbeginValueOn(); value; ++value) {
        const openvdb::Coord c = value.getCoord();
        visit(at++, {c.x(), c.y(), c.z()}, (*leaves[i].slots)[value->number]);
      }
    }
  });
}

class ReservoirGrid::Stream : public BlockStream {
 public:
  explicit Stream(std::vector<LeafPlace> leaves) : leaves_(std::move(leaves)) {
    std::sort(leaves_.begin(), leaves_.end(),
              [](const LeafPlace& a, const LeafPlace& b) { return a.block < b.block; });
  }
  Result<bool> Next(BlockReservoirs& out) override {
    if (next_ == leaves_.size()) return false;
    const LeafPlace& place = leaves_[next_++];
    out.block = place.block;
    out.cells.clear();
    for (auto value = place.leaf->cbeginValueOn(); value; ++value) {
      out.cells.push_back({static_cast<std::uint16_t>(value.pos()), (*place.slots)[value->number]});
    }
    return true;
  }

 private:
  std::vector<LeafPlace> leaves_;
  std::size_t next_ = 0;
};

std::unique_ptr<BlockStream> ReservoirGrid::Blocks() const {
  return std::make_unique<Stream>(Leaves());
}

}  // namespace strata
