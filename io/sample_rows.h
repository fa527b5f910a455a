// Samples as rows of fixed size: how they lie in a spool.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <vector>

#include "core/run_context.h"
#include "core/samples.h"
#include "io/spool.h"

namespace strata::io {

/// All bytes of a fixed attribute's column; of the positions for 0.
std::string_view ColumnBytes(const SampleColumns& columns, AttributeSet fixed);

/// Where each attribute lies in a row: bytes from its front. Absent ones are not set aside for.
class RowLayout {
 public:
  /// For the header's fixed attributes and carried columns.
  explicit RowLayout(const SampleHeader& header);

  std::size_t bytes() const { return bytes_; }
  /// Sample `i` of `columns`, to the row at `out`.
  void Pack(const SampleColumns& columns, std::size_t i, char* out) const;

  Vec3 Position(const char* row) const { return Get<Vec3>(row, 0); }
  Vec3f Normal(const char* row) const { return Get<Vec3f>(row, At(kNormal)); }
  std::uint64_t Triangle(const char* row) const { return Get<std::uint64_t>(row, At(kTriangle)); }
  std::array<double, 3> Barycentric(const char* row) const {
    return Get<std::array<double, 3>>(row, At(kBarycentric));
  }
  Cell CellOf(const char* row) const { return Get<Cell>(row, At(kCell)); }
  double Area(const char* row) const { return Get<double>(row, At(kArea)); }
  double Weight(const char* row) const { return Get<double>(row, At(kWeight)); }
  /// The value in carried column `k`: its bytes.
  const char* Carried(const char* row, std::size_t k) const { return row + carried_[k].at; }

 private:
  std::size_t At(Attribute attribute) const;
  template <class T>
  static T Get(const char* row, std::size_t at) {
    T value;
    std::memcpy(&value, row + at, sizeof value);
    return value;
  }

  AttributeSet attributes_;
  struct Column {
    std::size_t at, bytes;
  };
  std::array<std::size_t, kAttributeNames.size()> at_{};
  std::vector<Column> carried_;
  std::size_t bytes_ = sizeof(Vec3);
};

/// A run of rows in a spool, read from front to back any number of times. Owns neither.
class RowReader {
 public:
  /// `context` may be null; otherwise its cancel flag is looked at in every portion.
  RowReader(Spool& spool, const RowLayout& layout, std::uint64_t first, std::uint64_t count,
            const RunContext* context)
      : spool_(&spool), layout_(layout), first_(first), count_(count), context_(context) {}

  /// Calls `visit(row)` for each row. Memory: one portion of 64 KiB. Errors: kIo, kCancelled.
  template <class Visit>
  Result<void> ForEach(const Visit& visit) const {
    return ForEachPortion([&](std::span<const char> rows) -> Result<void> {
      for (std::size_t at = 0; at < rows.size(); at += layout_.bytes()) visit(rows.data() + at);
      return {};
    });
  }
  /// As ForEach, with several whole rows at once; `visit` returns Result<void>.
  template <class Visit>
  Result<void> ForEachPortion(const Visit& visit) const {
    const std::uint64_t rows_at_once = kPortionBytes / layout_.bytes();
    std::vector<char> portion(rows_at_once * layout_.bytes());
    for (std::uint64_t done = 0; done < count_; done += rows_at_once) {
      if (context_ != nullptr && context_->cancelled()) return Cancelled();
      const std::uint64_t n = std::min(rows_at_once, count_ - done);
      const std::span<char> rows(portion.data(), n * layout_.bytes());
      if (auto read = spool_->Read((first_ + done) * layout_.bytes(), rows); !read) return read;
      if (auto visited = visit(std::span<const char>(rows)); !visited) return visited;
    }
    return {};
  }
  /// Gives the space of all rows up to the last one back.
  void Discard() { spool_->DiscardBefore((first_ + count_) * layout_.bytes()); }

  std::uint64_t count() const { return count_; }
  const RowLayout& layout() const { return layout_; }

 private:
  static constexpr std::size_t kPortionBytes = std::size_t{1} << 16;

  Spool* spool_;
  RowLayout layout_;
  std::uint64_t first_, count_;
  const RunContext* context_;
};

}  // namespace strata::io
