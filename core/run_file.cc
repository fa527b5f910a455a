#include "core/run_file.h"

#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <string_view>
#include <utility>

namespace strata {
namespace {

static_assert(std::endian::native == std::endian::little, "runs are little endian");

constexpr std::size_t kCellsPerFrame = 1024;  // A frame ends with the block that reaches this.
constexpr std::size_t kMostCellsPerFrame = kCellsPerFrame + 512;
constexpr int kLevel = 1;
// Flags of a frame.
constexpr std::uint32_t kHasBarycentric = 1, kIsEnd = 2;

struct FrameHeader {
  std::uint32_t compressed_bytes, raw_bytes;
};
struct ContentHeader {
  std::uint32_t flags, blocks, cells, reserved;
};
struct EndContent {
  ContentHeader header;
  std::uint64_t blocks, cells;
};

std::size_t RawBytes(std::size_t blocks, std::size_t cells, bool barycentric) {
  return sizeof(ContentHeader) + blocks * (sizeof(Cell) + 2) + cells * (2 + 8 * 7 + 12) +
         (barycentric ? cells * 16 : 0);
}

// Columns one after another, each value as it lies in memory.
class ColumnWriter {
 public:
  explicit ColumnWriter(std::string& out) : out_(out) { out_.clear(); }
  template <class T>
  void Put(const T& value) {
    out_.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  template <class Range, class F>
  void Column(const Range& range, F&& value_of) {
    for (const auto& element : range) Put(value_of(element));
  }

 private:
  std::string& out_;
};

class ColumnReader {
 public:
  explicit ColumnReader(std::string_view in) : in_(in) {}
  // Precondition: the sizes were checked (RawBytes).
  template <class T>
  void Get(T& value) {
    std::memcpy(&value, in_.data(), sizeof value);
    in_.remove_prefix(sizeof value);
  }
  template <class Range, class F>
  void Column(Range& range, F&& place_of) {
    for (auto& element : range) Get(place_of(element));
  }

 private:
  std::string_view in_;
};

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

}  // namespace

void RunWriter::FreeContext::operator()(ZSTD_CCtx_s* context) const { ZSTD_freeCCtx(context); }
void RunReader::FreeContext::operator()(ZSTD_DCtx_s* context) const { ZSTD_freeDCtx(context); }

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
  if (cells_.size() >= kCellsPerFrame) return WriteFrame();
  return {};
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
  return WriteCompressed(raw_);
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
  extent_.bytes += sizeof header + n;
  return append_({compressed_.data(), sizeof header + n});
}

Result<RunExtent> RunWriter::Finish() {
  if (!cells_.empty()) {
    if (auto written = WriteFrame(); !written) return Forward(written);
  }
  const EndContent end{{kIsEnd, 0, 0, 0}, extent_.blocks, extent_.cells};
  auto written = WriteCompressed({reinterpret_cast<const char*>(&end), sizeof end});
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
    : file_(file),
      damage_(damage),
      begin_(extent.offset),
      at_(extent.offset),
      end_(extent.offset + extent.bytes),
      context_(ZSTD_createDCtx()) {}
RunReader::~RunReader() = default;

Result<bool> RunReader::Next(BlockReservoirs& out) {
  if (next_block_ == blocks_.size()) {
    const auto more = ReadFrame();
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

Result<bool> RunReader::ReadFrame() {
  FrameHeader header;
  if (end_ - at_ < sizeof header) return Damaged("it ends before its last frame");
  auto read = file_.ReadAt(at_, {reinterpret_cast<char*>(&header), sizeof header});
  if (!read) return Forward(read);
  const std::size_t most = RawBytes(kMostCellsPerFrame, kMostCellsPerFrame, true);
  if (header.raw_bytes < sizeof(ContentHeader) || header.raw_bytes > most ||
      header.compressed_bytes > end_ - at_ - sizeof header ||
      header.compressed_bytes > ZSTD_compressBound(most)) {
    return Damaged("a frame claims " + std::to_string(header.compressed_bytes) + " bytes for " +
                   std::to_string(header.raw_bytes));
  }
  compressed_.resize(header.compressed_bytes);
  read = file_.ReadAt(at_ + sizeof header, compressed_);
  if (!read) return Forward(read);
  raw_.resize(header.raw_bytes);
  const std::size_t n = ZSTD_decompressDCtx(context_.get(), raw_.data(), raw_.size(),
                                            compressed_.data(), compressed_.size());
  if (ZSTD_isError(n)) return Damaged(ZSTD_getErrorName(n));
  if (n != raw_.size()) return Damaged("a frame is shorter than it says");
  std::uint32_t flags = 0;
  std::memcpy(&flags, raw_.data(), sizeof flags);
  const std::uint64_t frame_bytes = sizeof header + header.compressed_bytes;
  if ((flags & kIsEnd) != 0) return ReadEnd(static_cast<std::uint32_t>(frame_bytes));
  if (auto unpacked = Unpack(); !unpacked) return Forward(unpacked);
  at_ += frame_bytes;
  return true;
}

Result<void> RunReader::Unpack() {
  ColumnReader in(raw_);
  ContentHeader content;
  in.Get(content);
  const bool barycentric = (content.flags & kHasBarycentric) != 0;
  if (content.cells > kMostCellsPerFrame || content.blocks > content.cells || content.blocks == 0 ||
      RawBytes(content.blocks, content.cells, barycentric) != raw_.size()) {
    return Damaged("a frame's counts do not fit its size");
  }
  const Cell last = blocks_.empty() ? Cell{} : blocks_.back();
  const bool first_frame = blocks_.empty();
  blocks_.resize(content.blocks);
  counts_.resize(content.blocks);
  cells_.assign(content.cells, {});
  in.Column(blocks_, [](Cell& c) -> Cell& { return c; });
  in.Column(counts_, [](std::uint16_t& n) -> std::uint16_t& { return n; });
  ForEachColumn(barycentric, [&](auto&& field) { in.Column(cells_, field); });
  if (!AreCellsInOrder(counts_, cells_)) return Damaged("a block's cells are not in order");
  const bool ascending =
      (first_frame || last < blocks_.front()) &&
      std::adjacent_find(blocks_.begin(), blocks_.end(), std::greater_equal<>()) == blocks_.end();
  if (!ascending) return Damaged("a frame's blocks are not in order");
  blocks_read_ += blocks_.size();
  cells_read_ += cells_.size();
  next_block_ = next_cell_ = 0;
  return {};
}

Result<bool> RunReader::ReadEnd(std::uint32_t frame_bytes) {
  EndContent end;
  if (raw_.size() != sizeof end) return Damaged("its end has a wrong size");
  std::memcpy(&end, raw_.data(), sizeof end);
  if (end.blocks != blocks_read_ || end.cells != cells_read_) {
    return Damaged("it holds " + std::to_string(cells_read_) + " cells; expected " +
                   std::to_string(end.cells));
  }
  if (at_ + frame_bytes != end_) return Damaged("bytes follow its end");
  blocks_.clear();
  next_block_ = 0;
  return false;
}

tl::unexpected<Error> RunReader::Damaged(const std::string& what) const {
  const std::string place = damage_ == ErrorCode::kIo ? "scratch space " : "";
  return Fail(damage_, place + file_.name() + ": the run from byte " + std::to_string(begin_) +
                           " is damaged at byte " + std::to_string(at_) + ": " + what);
}

}  // namespace strata
