#include "core/run_file.h"

#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string_view>
#include <utility>

#include "core/run_frame.h"

namespace strata {
namespace {

constexpr int kLevel = 1;
constexpr std::size_t kOffsetsPerFrame = 4096;

// Calls `column` with a function from an entry to each of its fields in turn.
template <class F>
void ForEachColumn(bool barycentric, F&& column) {
  using Entry = BlockReservoirs::Entry;
  column([](auto& e) -> auto& { return e.offset; });
  column([](auto& e) -> auto& { return e.reservoir.time; });
  column([](auto& e) -> auto& { return e.reservoir.hash; });
  column([](auto& e) -> auto& { return e.reservoir.triangle; });
  column([](auto& e) -> auto& { return e.reservoir.local.x; });
  column([](auto& e) -> auto& { return e.reservoir.local.y; });
  column([](auto& e) -> auto& { return e.reservoir.local.z; });
  column([](auto& e) -> auto& { return e.reservoir.normal; });
  column([](auto& e) -> auto& { return e.reservoir.area; });
  if (!barycentric) return;
  column([](auto& e) -> auto& { return e.reservoir.barycentric[0]; });
  column([](auto& e) -> auto& { return e.reservoir.barycentric[1]; });
  static_assert(sizeof(Entry::reservoir.normal) == 12);
}

// Whether every block has cells, each once, by offset, and all belong to one.
bool AreCellsInOrder(const std::vector<std::uint16_t>& counts,
                     const std::vector<BlockReservoirs::Entry>& cells) {
  std::size_t at = 0;
  for (const std::uint16_t n : counts) {
    if (n == 0 || n > cells.size() - at) return false;
    for (std::size_t i = at + 1; i < at + n; ++i) {
      if (cells[i - 1].offset >= cells[i].offset) return false;
    }
    at += n;
    if (cells[at - 1].offset >= 512) return false;
  }
  return at == cells.size();
}

// By how many blocks a sample lies outside the block of its cell. What comes within rounding of a
// face counts as outside.
std::uint64_t SpreadOf(const BlockReservoirs::Entry& entry) {
  const Vec3& local = entry.reservoir.local;
  const double farthest = std::max({std::abs(local.x), std::abs(local.y), std::abs(local.z)});
  if (farthest <= 0.5) return 0;
  const Cell cell = CellOf({}, entry.offset);
  const Vec3 at = Vec3{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5} + local;
  double outside = -1;
  for (int a = 0; a < 3; ++a) outside = std::max({outside, -at[a], at[a] - 8});
  const double blocks = std::ceil((outside + 1e-6) / 8);
  if (!(blocks > 0)) return 0;
  constexpr auto kMost = std::numeric_limits<std::uint32_t>::max();
  return blocks < kMost ? static_cast<std::uint64_t>(blocks) : kMost;
}

}  // namespace

void RunWriter::FreeContext::operator()(ZSTD_CCtx_s* context) const { ZSTD_freeCCtx(context); }

// --- The index -------------------------------------------------------------------------------

void IndexBuilder::Add(const BlockReservoirs& block) {
  CellMask mask{};
  for (const BlockReservoirs::Entry& entry : block.cells) {
    mask[entry.offset / 64 % mask.size()] |= std::uint64_t{1} << (entry.offset % 64);
    spread_ = std::max(spread_, SpreadOf(entry));
  }
  blocks_.push_back(block.block);
  masks_.push_back(mask);
}

void IndexBuilder::EndFrame(std::uint64_t bytes) {
  frame_bytes_.push_back(static_cast<std::uint32_t>(bytes));
  frame_blocks_.push_back(static_cast<std::uint32_t>(blocks_.size() - framed_));
  framed_ = blocks_.size();
}

bool IndexBuilder::full() const { return blocks_.size() >= kBlocksPerIndex; }

void IndexBuilder::Pack(std::string& out) {
  ColumnWriter column(out);
  column.Put(ContentHeader{kIsIndex, static_cast<std::uint32_t>(blocks_.size()), 0,
                           static_cast<std::uint32_t>(frame_bytes_.size())});
  const auto same = [](const auto& value) -> const auto& { return value; };
  column.Column(frame_bytes_, same);
  column.Column(frame_blocks_, same);
  column.Column(blocks_, same);
  column.Column(masks_, same);
  blocks_.clear();
  masks_.clear();
  frame_bytes_.clear();
  frame_blocks_.clear();
  framed_ = 0;
}

// --- Writing ---------------------------------------------------------------------------------

RunWriter::RunWriter(AppendBytes append, std::uint64_t begin, bool barycentric)
    : append_(std::move(append)), barycentric_(barycentric), context_(ZSTD_createCCtx()) {
  extent_.offset = begin;
  ZSTD_CCtx_setParameter(context_.get(), ZSTD_c_compressionLevel, kLevel);
  ZSTD_CCtx_setParameter(context_.get(), ZSTD_c_checksumFlag, 1);
}
RunWriter::~RunWriter() = default;

Result<void> RunWriter::Add(const BlockReservoirs& block) {
  blocks_.push_back(block.block);
  counts_.push_back(static_cast<std::uint16_t>(block.cells.size()));
  cells_.insert(cells_.end(), block.cells.begin(), block.cells.end());
  index_.Add(block);
  if (cells_.size() < kCellsPerFrame && blocks_.size() < kBlocksPerFrame) return {};
  auto written = WriteFrame();
  return written && index_.full() ? WriteIndex() : written;
}

Result<void> RunWriter::WriteFrame() {
  ColumnWriter out(raw_);
  out.Put(ContentHeader{barycentric_ ? kHasBarycentric : 0,
                        static_cast<std::uint32_t>(blocks_.size()),
                        static_cast<std::uint32_t>(cells_.size()), 0});
  out.Column(blocks_, [](const Cell& c) { return c; });
  out.Column(counts_, [](std::uint16_t n) { return n; });
  ForEachColumn(barycentric_, [&](auto&& field) { out.Column(cells_, field); });
  extent_.blocks += blocks_.size();
  extent_.cells += cells_.size();
  blocks_.clear();
  counts_.clear();
  cells_.clear();
  const std::uint64_t before = extent_.bytes;
  auto written = WriteCompressed(raw_);
  index_.EndFrame(extent_.bytes - before);
  return written;
}

Result<void> RunWriter::WriteIndex() {
  directory_.push_back(extent_.bytes);
  index_.Pack(raw_);
  return WriteCompressed(raw_);
}

Result<void> RunWriter::WriteDirectory() {
  for (std::size_t first = 0; first < directory_.size(); first += kOffsetsPerFrame) {
    const std::size_t n = std::min(kOffsetsPerFrame, directory_.size() - first);
    ColumnWriter out(raw_);
    out.Put(ContentHeader{kIsDirectory, 0, 0, static_cast<std::uint32_t>(n)});
    for (std::size_t i = 0; i < n; ++i) out.Put(directory_[first + i]);
    if (auto written = WriteCompressed(raw_); !written) return written;
  }
  return {};
}

Result<void> RunWriter::WriteCompressed(std::string_view raw) {
  compressed_.resize(sizeof(FrameHeader) + ZSTD_compressBound(raw.size()));
  const std::size_t n =
      ZSTD_compress2(context_.get(), compressed_.data() + sizeof(FrameHeader),
                     compressed_.size() - sizeof(FrameHeader), raw.data(), raw.size());
  if (ZSTD_isError(n)) {
    return Fail(ErrorCode::kInternal, std::string("zstd: ") + ZSTD_getErrorName(n));
  }
  const FrameHeader header{static_cast<std::uint32_t>(n), static_cast<std::uint32_t>(raw.size())};
  std::memcpy(compressed_.data(), &header, sizeof header);
  return Put({compressed_.data(), sizeof header + n});
}

Result<void> RunWriter::Put(std::string_view bytes) {
  extent_.bytes += bytes.size();
  return append_(bytes);
}

Result<RunExtent> RunWriter::Finish() {
  Result<void> written;
  if (!cells_.empty()) written = WriteFrame();
  if (written && !index_.empty()) written = WriteIndex();
  const std::uint64_t directory = extent_.bytes;
  if (written) written = WriteDirectory();
  const std::uint64_t last = extent_.bytes;
  const EndContent end{
      {kIsEnd, 0, 0, 0}, extent_.blocks, extent_.cells, index_.spread(), last - directory};
  if (written) written = WriteCompressed({reinterpret_cast<const char*>(&end), sizeof end});
  const auto trailer = static_cast<RunTrailer>(extent_.bytes - last);
  if (written) written = Put({reinterpret_cast<const char*>(&trailer), sizeof trailer});
  if (!written) return Forward(written);
  return extent_;
}

Result<RunExtent> RunWriter::WriteAll(BlockStream& blocks, const RunContext* context) {
  BlockReservoirs block;
  for (;;) {
    if (context != nullptr && context->cancelled()) return Cancelled();
    const auto more = blocks.Next(block);
    if (!more) return Forward(more);
    if (!*more) return Finish();
    if (auto added = Add(block); !added) return Forward(added);
  }
}

// --- Reading ---------------------------------------------------------------------------------

RunReader::RunReader(const ScratchFile& file, const RunExtent& extent, ErrorCode damage)
    : RunReader(file, extent, nullptr, damage) {}
RunReader::RunReader(const ScratchFile& file, const RunExtent& extent,
                     std::shared_ptr<const std::vector<std::uint64_t>> frames, ErrorCode damage)
    : frame_(std::make_unique<FrameReader>(file, extent, damage, NewUnpackContext())),
      chosen_(std::move(frames)) {}
RunReader::~RunReader() = default;

Result<bool> RunReader::Next(BlockReservoirs& out) {
  if (next_block_ == blocks_.size()) {
    const auto more = chosen_ ? ReadChosenFrame() : ReadFrame();
    if (!more || !*more) return more;
  }
  out.block = blocks_[next_block_];
  const std::size_t count = counts_[next_block_];
  const auto first = cells_.begin() + static_cast<std::ptrdiff_t>(next_cell_);
  out.cells.assign(first, first + static_cast<std::ptrdiff_t>(count));
  next_cell_ += count;
  ++next_block_;
  return true;
}

Result<bool> RunReader::ReadChosenFrame() {
  if (next_chosen_ == chosen_->size()) return false;
  if (auto read = frame_->Read((*chosen_)[next_chosen_++]); !read) return Forward(read);
  if ((frame_->header().flags & ~kHasBarycentric) != 0) {
    return frame_->Damaged("its index names a frame that holds no reservoirs");
  }
  if (auto unpacked = Unpack(); !unpacked) return Forward(unpacked);
  return true;
}

Result<bool> RunReader::ReadFrame() {
  while (!at_end_) {
    if (auto read = frame_->Read(frame_->next()); !read) return Forward(read);
    const std::uint32_t flags = frame_->header().flags;
    if ((flags & kIsEnd) != 0) return ReadEnd();
    if ((flags & (kIsIndex | kIsDirectory)) == 0) {
      if (auto unpacked = Unpack(); !unpacked) return Forward(unpacked);
      return true;
    }
    if (auto checked = CheckIndex(); !checked) return Forward(checked);
  }
  return false;
}

// Every block must be known to the index, or a reader that relies on it would miss some.
Result<void> RunReader::CheckIndex() {
  indexed_ += frame_->header().blocks;
  if (indexed_ != blocks_read_) return frame_->Damaged("its index names other blocks");
  return {};
}

Result<void> RunReader::Unpack() {
  ColumnReader in(frame_->content());
  ContentHeader content;
  in.Get(content);
  const bool barycentric = (content.flags & kHasBarycentric) != 0;
  if (content.cells > kMostCellsPerFrame || content.blocks > kBlocksPerFrame ||
      content.blocks > content.cells || content.blocks == 0 ||
      RawBytes(content.blocks, content.cells, barycentric) != frame_->content().size()) {
    return frame_->Damaged("a frame's counts do not fit its size");
  }
  const Cell last = blocks_.empty() ? Cell{} : blocks_.back();
  const bool first_frame = blocks_.empty();
  blocks_.resize(content.blocks);
  counts_.resize(content.blocks);
  cells_.assign(content.cells, {});
  in.Column(blocks_, [](Cell& c) -> Cell& { return c; });
  in.Column(counts_, [](std::uint16_t& n) -> std::uint16_t& { return n; });
  ForEachColumn(barycentric, [&](auto&& field) { in.Column(cells_, field); });
  if (!AreCellsInOrder(counts_, cells_)) {
    return frame_->Damaged("a block's cells are not in order");
  }
  const bool ascending =
      (first_frame || last < blocks_.front()) &&
      std::adjacent_find(blocks_.begin(), blocks_.end(), std::greater_equal<>()) == blocks_.end();
  if (!ascending) return frame_->Damaged("a frame's blocks are not in order");
  blocks_read_ += blocks_.size();
  cells_read_ += cells_.size();
  next_block_ = next_cell_ = 0;
  return {};
}

Result<bool> RunReader::ReadEnd() {
  EndContent end;
  if (frame_->content().size() != sizeof end) return frame_->Damaged("its end has a wrong size");
  std::memcpy(&end, frame_->content().data(), sizeof end);
  if (end.blocks != blocks_read_ || end.cells != cells_read_) {
    return frame_->Damaged("it holds " + std::to_string(cells_read_) + " cells; expected " +
                           std::to_string(end.cells));
  }
  if (indexed_ != blocks_read_) return frame_->Damaged("its index names other blocks");
  RunTrailer trailer = 0;
  if (frame_->end() - frame_->next() != sizeof trailer) {
    return frame_->Damaged("a wrong number of bytes follows its end");
  }
  auto read =
      frame_->file().ReadAt(frame_->next(), {reinterpret_cast<char*>(&trailer), sizeof trailer});
  if (!read) return Forward(read);
  if (trailer != frame_->next() - frame_->at()) return frame_->Damaged("its end has a wrong size");
  blocks_.clear();
  next_block_ = 0;
  at_end_ = true;
  return false;
}

}  // namespace strata
