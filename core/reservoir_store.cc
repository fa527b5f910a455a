#include "core/reservoir_store.h"

#include <algorithm>
#include <string>
#include <utility>

#include "core/block_merge.h"
#include "core/checkpoint.h"
#include "core/memory_account.h"

namespace strata {
namespace {

// A quarter of the memory that is left goes to the runs that are merged at a time.
std::size_t StreamsAtOnce(const MemoryAccount& memory) {
  return static_cast<std::size_t>(
      std::clamp<std::uint64_t>(memory.left() / 4 / kRunBufferBytes, 2, 256));
}

// Some blocks of a stream.
class WantedBlocks : public BlockStream {
 public:
  WantedBlocks(std::unique_ptr<BlockStream> stream, std::function<bool(Cell)> wanted)
      : stream_(std::move(stream)), wanted_(std::move(wanted)) {}
  Result<bool> Next(BlockReservoirs& out) override {
    for (;;) {
      const auto more = stream_->Next(out);
      if (!more || !*more || wanted_(out.block)) return more;
    }
  }

 private:
  std::unique_ptr<BlockStream> stream_;
  std::function<bool(Cell)> wanted_;
};

}  // namespace

ReservoirStore::ReservoirStore(const StoreLimits& limits)
    : limits_(limits), grid_(std::make_unique<ReservoirGrid>()) {}

ReservoirStore::~ReservoirStore() { Settle(); }

void ReservoirStore::Merge(const CellCache& cache) {
  bool spill = false;
  {
    const std::shared_lock<std::shared_mutex> lock(grid_mutex_);
    grid_->Merge(cache);
    spill = limits_.scratch != nullptr && grid_->bytes() > limits_.max_bytes / 2;
  }
  if (spill) Spill();
}

bool ReservoirStore::full() const {
  if (failed_.load(std::memory_order_relaxed)) return true;
  return limits_.scratch == nullptr && grid_->size() > limits_.max_cells;
}

Result<void> ReservoirStore::status() {
  Settle();
  if (failure_) return tl::unexpected<Error>(*failure_);
  if (!full()) return {};
  return Fail(ErrorCode::kOverBudget,
              "more than " + std::to_string(limits_.max_cells) +
                  " cells are occupied, which is what memory is set aside for; use a coarser "
                  "lattice, or scratch space");
}

void ReservoirStore::Spill() {
  const std::lock_guard<std::mutex> one_at_a_time(spill_mutex_);
  std::unique_ptr<ReservoirGrid> frozen;
  {
    const std::unique_lock<std::shared_mutex> lock(grid_mutex_);
    // Another worker may have been here first.
    if (grid_->bytes() <= limits_.max_bytes / 2 || failure_) return;
    frozen = std::exchange(grid_, std::make_unique<ReservoirGrid>());
    spilled_ = true;
  }
  const auto run = WriteRun(*frozen->Blocks());
  if (run) runs_.push_back(*run);
  Note(run ? Result<void>() : Result<void>(Forward(run)));
  frozen.reset();
  ReturnFreedMemory();  // Before the next grid comes this far.
}

void ReservoirStore::Note(const Result<void>& written) {
  if (written || failure_) return;
  failure_ = written.error();
  failed_.store(true, std::memory_order_relaxed);
}

// --- Checkpoints ---------------------------------------------------------------------------------

bool ReservoirStore::wants_checkpoint() {
  const std::shared_lock<std::shared_mutex> lock(grid_mutex_);
  // Three quarters of what workers would let it come to; less once they have been that far.
  const std::uint64_t enough = limits_.max_bytes / 8 * (spilled_ ? 1 : 3);
  return grid_->size() > 0 && grid_->bytes() > enough;
}

void ReservoirStore::Settle() {
  if (writer_.joinable()) writer_.join();
}

void ReservoirStore::Checkpoint(SaveRuns save) {
  Settle();
  if (failure_) return;
  save_ = std::move(save);
  spilled_ = false;
  // What workers add from here on may be written first, but is not of this checkpoint.
  writer_ =
      std::thread([this, held = runs_,
                   frozen = std::exchange(grid_, std::make_unique<ReservoirGrid>())]() mutable {
        const std::lock_guard<std::mutex> one_at_a_time(spill_mutex_);
        Note(WriteCheckpoint(*frozen, std::move(held)));
        frozen.reset();
        ReturnFreedMemory();
      });
}

Result<void> ReservoirStore::WriteCheckpoint(const ReservoirGrid& frozen,
                                             std::vector<StoredRun> held) {
  if (frozen.size() > 0) {
    const auto run = WriteRun(*frozen.Blocks());
    if (!run) return Forward(run);
    runs_.push_back(*run);
    held.push_back(*run);
  }
  return SaveCheckpoint(held);
}

Result<void> ReservoirStore::SaveCheckpoint(std::span<const StoredRun> runs) const {
  std::vector<RunExtent> extents;
  for (const StoredRun& run : runs) extents.push_back(run.extent);
  return save_(extents);
}

Result<void> ReservoirStore::Restore(const std::vector<RunExtent>& runs) {
  std::uint64_t end = 0;
  for (const RunExtent& extent : runs) end = std::max(end, extent.offset + extent.bytes);
  if (auto opened = OpenFile(end); !opened) return opened;
  for (const RunExtent& extent : runs) runs_.push_back({file_, extent});
  return {};
}

// --- Runs ----------------------------------------------------------------------------------------

Result<void> ReservoirStore::OpenFile(std::uint64_t keep) {
  if (file_) return {};
  if (limits_.scratch == nullptr) {
    return Fail(ErrorCode::kInvalidArgument, "merging runs needs scratch space");
  }
  auto file =
      limits_.checkpoints ? limits_.checkpoints->OpenRuns(keep) : limits_.scratch->NewFile();
  if (!file) return Forward(file);
  file_ = std::move(*file);
  return {};
}

Result<StoredRun> ReservoirStore::WriteRun(BlockStream& blocks) {
  if (auto opened = OpenFile(0); !opened) return Forward(opened);
  RunWriter writer([this](std::string_view bytes) { return file_->Append(bytes); }, file_->size(),
                   limits_.barycentric);
  const auto extent = writer.WriteAll(blocks, limits_.context);
  if (!extent) return Forward(extent);
  return StoredRun{file_, *extent};
}

void ReservoirStore::Adopt(StoredRun run) { runs_.push_back(std::move(run)); }

// What this store wrote and cannot read back is the disk's fault; an adopted run is an input.
std::unique_ptr<BlockStream> ReservoirStore::Open(const StoredRun& run) const {
  const ErrorCode damage = run.file == file_ ? ErrorCode::kIo : ErrorCode::kCorruptInput;
  auto stream = std::make_unique<RunReader>(*run.file, run.extent, run.frames, damage);
  if (!run.wanted) return stream;
  return std::make_unique<WantedBlocks>(std::move(stream), run.wanted);
}

// Merges the first `count` runs into one at the end.
Result<void> ReservoirStore::MergeRuns(std::size_t count) {
  std::vector<std::unique_ptr<BlockStream>> streams;
  for (std::size_t i = 0; i < count; ++i) {
    streams.push_back(Open(runs_[i]));
  }
  BlockMerge merged(std::move(streams));
  const auto run = WriteRun(merged);
  if (!run) return Forward(run);
  std::vector<StoredRun> kept(runs_.begin() + static_cast<std::ptrdiff_t>(count), runs_.end());
  kept.push_back(*run);
  if (save_) {
    if (auto saved = SaveCheckpoint(kept); !saved) return saved;
  }
  for (std::size_t i = 0; i < count; ++i) {
    if (runs_[i].file != file_) continue;
    file_->Discard(runs_[i].extent.offset, runs_[i].extent.bytes);
  }
  runs_ = std::move(kept);
  return {};
}

Result<std::unique_ptr<BlockStream>> ReservoirStore::Blocks(const MemoryAccount& memory) {
  Settle();
  if (runs_.empty()) return grid_->Blocks();
  // Several passes over the result are cheaper over one run.
  if (grid_->size() > 0) {
    const auto run = WriteRun(*grid_->Blocks());
    if (!run) return Forward(run);
    runs_.push_back(*run);
    grid_ = std::make_unique<ReservoirGrid>();
    ReturnFreedMemory();
  }
  while (runs_.size() > 1) {
    const std::size_t count = std::min(runs_.size(), StreamsAtOnce(memory));
    if (auto merged = MergeRuns(count); !merged) return Forward(merged);
  }
  return Open(runs_.front());
}

}  // namespace strata
