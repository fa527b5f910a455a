// Finding the corners of a polygon that lie in a triangle, without looking at all of them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory_resource>
#include <span>
#include <vector>

namespace strata::io {

/// A corner as seen along the polygon's normal.
struct Point2 {
  double u = 0, v = 0;
  friend bool operator==(const Point2&, const Point2&) = default;
};

/// Twice the signed area of abc: positive if it turns counter-clockwise. For coordinates that are
/// floats of similar magnitude the sign is exact.
inline double Turn(Point2 a, Point2 b, Point2 c) {
  return (b.u - a.u) * (c.v - a.v) - (b.v - a.v) * (c.u - a.u);
}

/// A uniform grid of buckets over a polygon's reflex corners, the only ones that can lie in an ear.
class CornerGrid {
 public:
  explicit CornerGrid(std::pmr::memory_resource* memory)
      : first_(memory), last_(memory), items_(memory) {}

  /// Files `corners`, indices into `points`; about two per bucket. Precondition: finite points.
  void Build(std::span<const Point2> points, std::span<const std::uint32_t> corners);

  /// True if `blocks` says so of a corner filed near the triangle abc. Corners of which `obsolete`
  /// is true are dropped for good. Takes a unit from `work_left` per corner and bucket looked at,
  /// and returns true once it is used up.
  template <class Obsolete, class Blocks>
  bool AnyInTriangle(Point2 a, Point2 b, Point2 c, std::int64_t& work_left, Obsolete&& obsolete,
                     Blocks&& blocks) {
    --work_left;
    if (items_.empty()) return false;
    const double low_v = std::min({a.v, b.v, c.v}), high_v = std::max({a.v, b.v, c.v});
    const std::uint32_t first_row = Row(low_v), last_row = Row(high_v);
    for (std::uint32_t row = first_row; row <= last_row; ++row) {
      const Range columns = ColumnsInRow(row, a, b, c);
      for (std::uint32_t column = columns.first; column <= columns.last; ++column) {
        if (--work_left < 0) return true;
        if (AnyInBucket(std::size_t{row} * columns_ + column, work_left, obsolete, blocks))
          return true;
      }
    }
    return false;
  }

 private:
  struct Range {
    std::uint32_t first, last;
  };

  template <class Obsolete, class Blocks>
  bool AnyInBucket(std::size_t bucket, std::int64_t& work_left, Obsolete& obsolete,
                   Blocks& blocks) {
    for (std::uint32_t k = first_[bucket]; k < last_[bucket];) {
      --work_left;
      if (obsolete(items_[k])) {
        items_[k] = items_[--last_[bucket]];
      } else if (blocks(items_[k])) {
        return true;
      } else {
        ++k;
      }
    }
    return false;
  }

  static std::uint32_t Along(double offset, double scale, std::uint32_t cells) {
    const double cell = offset * scale;
    if (!(cell > 0)) return 0;
    return cell < cells - 1 ? static_cast<std::uint32_t>(cell) : cells - 1;
  }
  std::uint32_t Row(double v) const { return Along(v - low_.v, scale_.v, rows_); }
  std::uint32_t Column(double u) const { return Along(u - low_.u, scale_.u, columns_); }
  void ChooseCells(std::size_t corners, double width, double height);
  // The columns that the triangle can touch within a row, a bucket generous to either side.
  Range ColumnsInRow(std::uint32_t row, Point2 a, Point2 b, Point2 c) const;

  Point2 low_, scale_;
  std::uint32_t columns_ = 1, rows_ = 1;
  std::pmr::vector<std::uint32_t> first_, last_,
      items_;  // Bucket k is items_[first_[k], last_[k]).
};

}  // namespace strata::io
