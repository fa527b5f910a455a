#include "core/run_index.h"

#include <algorithm>
#include <cstring>
#include <functional>
#include <utility>

#include "core/run_frame.h"

namespace strata {
namespace {

constexpr std::size_t BytesOfPart(std::size_t blocks, std::size_t frames) {
  return sizeof(ContentHeader) + frames * 8 + blocks * (sizeof(Cell) + sizeof(CellMask));
}

}  // namespace

RunIndex::RunIndex(std::unique_ptr<FrameReader> frame, const RunExtent& extent)
    : frame_(std::move(frame)), extent_(extent) {}
RunIndex::~RunIndex() = default;

Result<std::unique_ptr<RunIndex>> RunIndex::Open(const ScratchFile& file, const RunExtent& extent,
                                                 std::shared_ptr<ZSTD_DCtx_s> unpack) {
  auto frame =
      std::make_unique<FrameReader>(file, extent, ErrorCode::kCorruptInput, std::move(unpack));
  std::unique_ptr<RunIndex> index(new RunIndex(std::move(frame), extent));
  if (auto read = index->ReadEnd(); !read) return Forward(read);
  return index;
}

Result<void> RunIndex::ReadEnd() {
  const std::uint64_t end = frame_->end();
  RunTrailer trailer = 0;
  if (end - frame_->begin() < sizeof trailer) return frame_->Damaged("it has no end");
  auto read = frame_->file().ReadAt(end - sizeof trailer,
                                    {reinterpret_cast<char*>(&trailer), sizeof trailer});
  if (!read) return read;
  if (trailer > end - sizeof trailer - frame_->begin()) return frame_->Damaged("it has no end");
  const std::uint64_t at = end - sizeof trailer - trailer;
  if (read = frame_->Read(at); !read) return read;
  EndContent content;
  if ((frame_->header().flags & kIsEnd) == 0 || frame_->next() != end - sizeof trailer ||
      frame_->content().size() != sizeof content) {
    return frame_->Damaged("it has no end");
  }
  std::memcpy(&content, frame_->content().data(), sizeof content);
  extent_.blocks = content.blocks;
  extent_.cells = content.cells;
  spread_ = content.spread;
  if (content.directory_bytes > at - frame_->begin()) {
    return frame_->Damaged("its directory does not fit it");
  }
  return ReadDirectory(at - content.directory_bytes, at);
}

Result<void> RunIndex::ReadDirectory(std::uint64_t begin, std::uint64_t end) {
  for (std::uint64_t at = begin; at < end; at = frame_->next()) {
    if (auto read = frame_->Read(at); !read) return read;
    const ContentHeader& header = frame_->header();
    if (header.flags != kIsDirectory ||
        frame_->content().size() != sizeof header + header.frames * std::uint64_t{8}) {
      return frame_->Damaged("its directory is none");
    }
    ColumnReader in(frame_->content().substr(sizeof header));
    for (std::uint32_t i = 0; i < header.frames; ++i) {
      std::uint64_t offset = 0;
      in.Get(offset);
      if (offset >= begin - frame_->begin() ||
          (!parts_.empty() && frame_->begin() + offset <= parts_.back())) {
        return frame_->Damaged("its directory is not in order");
      }
      parts_.push_back(frame_->begin() + offset);
    }
  }
  return {};
}

Result<bool> RunIndex::Next(IndexedBlock& out) {
  if (next_block_ == blocks_.size()) {
    if (next_part_ == parts_.size()) {
      if (blocks_read_ == extent_.blocks && cells_read_ == extent_.cells) return false;
      return frame_->Damaged("its index names " + std::to_string(cells_read_) +
                             " cells; expected " + std::to_string(extent_.cells));
    }
    if (auto read = ReadPart(); !read) return Forward(read);
  }
  out = blocks_[next_block_++];
  ++blocks_read_;
  cells_read_ += CellsIn(out.cells);
  return true;
}

void RunIndex::Rewind() {
  blocks_.clear();
  next_block_ = next_part_ = 0;
  blocks_read_ = cells_read_ = 0;
}

Result<void> RunIndex::ReadPart() {
  const std::uint64_t part = parts_[next_part_++];
  if (auto read = frame_->Read(part); !read) return read;
  const ContentHeader& header = frame_->header();
  if (header.flags != kIsIndex || header.blocks == 0 || header.blocks > kMostBlocksPerIndex ||
      header.frames > header.blocks ||
      frame_->content().size() != BytesOfPart(header.blocks, header.frames)) {
    return frame_->Damaged("its index is none");
  }
  const bool first = blocks_.empty();
  const Cell last = first ? Cell{} : blocks_.back().block;
  std::vector<std::uint32_t> frame_bytes(header.frames), frame_blocks(header.frames);
  blocks_.assign(header.blocks, {});
  ColumnReader in(frame_->content().substr(sizeof header));
  const auto same = [](std::uint32_t& value) -> std::uint32_t& { return value; };
  in.Column(frame_bytes, same);
  in.Column(frame_blocks, same);
  in.Column(blocks_, [](IndexedBlock& b) -> Cell& { return b.block; });
  in.Column(blocks_, [](IndexedBlock& b) -> CellMask& { return b.cells; });
  next_block_ = 0;
  const auto not_before = [](const IndexedBlock& a, const IndexedBlock& b) {
    return a.block >= b.block;
  };
  if ((!first && last >= blocks_.front().block) ||
      std::adjacent_find(blocks_.begin(), blocks_.end(), not_before) != blocks_.end()) {
    return frame_->Damaged("its index is not in order");
  }
  return PlaceFrames(part, frame_bytes, frame_blocks);
}

// The frames that an index frame tells of stand before it, one after the other.
Result<void> RunIndex::PlaceFrames(std::uint64_t part, const std::vector<std::uint32_t>& bytes,
                                   const std::vector<std::uint32_t>& blocks) {
  std::uint64_t all = 0;
  for (const std::uint32_t n : bytes) all += n;
  if (all > part - frame_->begin()) return frame_->Damaged("its index names frames before it");
  std::uint64_t at = part - all;
  std::size_t block = 0;
  for (std::size_t f = 0; f < bytes.size(); ++f) {
    if (blocks[f] > blocks_.size() - block) return frame_->Damaged("its index is none");
    for (std::uint32_t i = 0; i < blocks[f]; ++i) blocks_[block++].frame = at;
    at += bytes[f];
  }
  if (block != blocks_.size()) return frame_->Damaged("its index is none");
  return {};
}

MergedIndex::MergedIndex(const std::vector<std::unique_ptr<RunIndex>>& indexes)
    : indexes_(indexes), front_(indexes.size()) {
  for (const auto& index : indexes) index->Rewind();
}

Result<void> MergedIndex::Advance(std::size_t run) {
  const auto more = indexes_[run]->Next(front_[run]);
  if (!more) return Forward(more);
  if (!*more) return {};
  heap_.push_back(run);
  std::push_heap(heap_.begin(), heap_.end(),
                 [&](std::size_t a, std::size_t b) { return front_[b].block < front_[a].block; });
  return {};
}

Result<bool> MergedIndex::Next(IndexedBlock& out) {
  for (std::size_t run = 0; !started_ && run < indexes_.size(); ++run) {
    if (auto advanced = Advance(run); !advanced) return Forward(advanced);
  }
  started_ = true;
  if (heap_.empty()) return false;
  out = {front_[heap_.front()].block, {}, 0};
  while (!heap_.empty() && front_[heap_.front()].block == out.block) {
    const std::size_t run = heap_.front();
    for (std::size_t w = 0; w < out.cells.size(); ++w) out.cells[w] |= front_[run].cells[w];
    std::pop_heap(heap_.begin(), heap_.end(),
                  [&](std::size_t a, std::size_t b) { return front_[b].block < front_[a].block; });
    heap_.pop_back();
    if (auto advanced = Advance(run); !advanced) return Forward(advanced);
  }
  return true;
}

}  // namespace strata
