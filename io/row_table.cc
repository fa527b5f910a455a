#include "io/row_table.h"

#include <algorithm>
#include <cstring>
#include <string>

namespace strata::io {
namespace {

constexpr std::size_t kPartBytes = std::size_t{1} << 18;
// Beyond, reading all of them costs more than sorting out the few that samples ask for.
constexpr std::uint64_t kSmallBytes = std::uint64_t{8} << 20;
// Rows that lie so close together are read at once.
constexpr std::size_t kReadBytes = std::size_t{1} << 16;

}  // namespace

RowTable::RowTable(std::size_t row_bytes, RunContext& context)
    : row_bytes_(row_bytes),
      per_part_(std::max(kPartBytes, row_bytes) / row_bytes),
      context_(&context),
      most_bytes_(context.memory().limited() ? context.memory().left() / 4 : UINT64_MAX) {}

RowTable::RowTable(std::size_t row_bytes, ByteSource& source, std::uint64_t offset,
                   std::uint64_t count)
    : row_bytes_(row_bytes),
      per_part_(std::max(kPartBytes, row_bytes) / row_bytes),
      source_(&source),
      offset_(offset),
      size_(count) {}

Result<void> RowTable::LoadIfSmall(RunContext& context) {
  if (source_ == nullptr || size_ > kSmallBytes / row_bytes_) return {};
  const std::uint64_t bytes = size_ * row_bytes_;
  if (context.memory().limited() && bytes > context.memory().left() / 8) return {};
  auto share = context.memory().Take(bytes, "the vertices' attributes");
  if (!share) return Forward(share);
  share_ = std::move(*share);
  for (std::uint64_t first = 0; first < size_; first += per_part_) {
    const std::uint64_t n = std::min<std::uint64_t>(per_part_, size_ - first);
    std::vector<char>& part = rows_.emplace_back(static_cast<std::size_t>(n) * row_bytes_);
    if (auto read = ReadAt(first * row_bytes_, part); !read) return read;
  }
  source_ = nullptr;
  return {};
}

Result<void> RowTable::Append(const char* row) {
  const std::size_t part = per_part_ * row_bytes_;
  if (rows_.empty() || rows_.back().size() == part) {
    if (rows_.size() * part >= most_bytes_ || file_ != nullptr) {
      if (auto spilled = Spill(); !spilled) return spilled;
    }
    rows_.emplace_back().reserve(part);
  }
  rows_.back().insert(rows_.back().end(), row, row + row_bytes_);
  ++size_;
  return {};
}

Result<void> RowTable::Spill() {
  if (context_->cancelled()) return Cancelled();
  if (file_ == nullptr) {
    if (context_->scratch() == nullptr) {
      return Fail(ErrorCode::kOverBudget,
                  "the vertices' attributes need more than " + std::to_string(most_bytes_) +
                      " bytes of the memory budget, and no scratch space was given");
    }
    auto file = context_->scratch()->NewFile();
    if (!file) return Forward(file);
    file_ = std::move(*file);
  }
  for (const std::vector<char>& part : rows_) {
    if (auto written = file_->Append({part.data(), part.size()}); !written) return written;
  }
  rows_.clear();
  return {};
}

Result<void> RowTable::Finish() {
  if (file_ != nullptr) return Spill();
  if (rows_.empty()) return {};
  auto share = context_->memory().Take(size_ * row_bytes_, "the vertices' attributes");
  if (!share) return Forward(share);
  share_ = std::move(*share);
  return {};
}

Result<void> RowTable::ReadAt(std::uint64_t offset, std::span<char> out) const {
  return source_ != nullptr ? source_->ReadAt(offset_ + offset, out) : file_->ReadAt(offset, out);
}

Result<void> RowTable::Gather(std::span<const std::uint64_t> numbers, char* out) const {
  if (resident()) {
    for (const std::uint64_t n : numbers) {
      std::memcpy(out, Row(n), row_bytes_);
      out += row_bytes_;
    }
    return {};
  }
  std::vector<char> window;
  for (std::size_t i = 0; i < numbers.size();) {
    std::size_t end = i + 1;
    const std::uint64_t first = numbers[i];
    while (end < numbers.size() && (numbers[end] - first + 1) * row_bytes_ <= kReadBytes) ++end;
    window.resize((numbers[end - 1] - first + 1) * row_bytes_);
    if (auto read = ReadAt(first * row_bytes_, window); !read) return read;
    for (; i < end; ++i) {
      std::memcpy(out, window.data() + (numbers[i] - first) * row_bytes_, row_bytes_);
      out += row_bytes_;
    }
  }
  return {};
}

}  // namespace strata::io
