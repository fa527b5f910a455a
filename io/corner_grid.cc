#include "io/corner_grid.h"

#include <array>
#include <utility>

namespace strata::io {
namespace {

// Few corners are looked through faster without a grid.
constexpr std::size_t kSmall = 16;

std::uint32_t RootOf(std::size_t n) {
  std::uint32_t root = 1;
  while (std::size_t{root} * root < n) ++root;
  return root;
}

}  // namespace

void CornerGrid::Build(std::span<const Point2> points, std::span<const std::uint32_t> corners) {
  items_.assign(corners.size(), 0);
  Point2 high{-HUGE_VAL, -HUGE_VAL};
  low_ = {HUGE_VAL, HUGE_VAL};
  for (const std::uint32_t i : corners) {
    low_ = {std::min(low_.u, points[i].u), std::min(low_.v, points[i].v)};
    high = {std::max(high.u, points[i].u), std::max(high.v, points[i].v)};
  }
  ChooseCells(corners.size(), high.u - low_.u, high.v - low_.v);
  const auto bucket = [&](std::uint32_t i) {
    return std::size_t{Row(points[i].v)} * columns_ + Column(points[i].u);
  };
  first_.assign(std::size_t{rows_} * columns_, 0);
  for (const std::uint32_t i : corners) ++first_[bucket(i)];
  std::uint32_t sum = 0;
  for (std::uint32_t& f : first_) sum += std::exchange(f, sum);
  last_ = first_;
  for (const std::uint32_t i : corners) items_[last_[bucket(i)]++] = i;
}

void CornerGrid::ChooseCells(std::size_t corners, double width, double height) {
  const std::size_t buckets = corners <= kSmall ? 1 : corners / 2;
  const std::uint32_t side = RootOf(buckets), all = static_cast<std::uint32_t>(buckets);
  // Corners in one line, like the roots of a comb's teeth, get the buckets along it.
  columns_ = !(width > 0) ? 1 : height > 0 ? side : all;
  rows_ = !(height > 0) ? 1 : width > 0 ? side : all;
  // An extent too small to divide by puts everything into one row or column.
  const auto scale = [](double extent, std::uint32_t cells) {
    const double s = cells / extent;
    return extent > 0 && std::isfinite(s) ? s : 0;
  };
  scale_ = {scale(width, columns_), scale(height, rows_)};
}

CornerGrid::Range CornerGrid::ColumnsInRow(std::uint32_t row, Point2 a, Point2 b, Point2 c) const {
  const double low_u = std::min({a.u, b.u, c.u}), high_u = std::max({a.u, b.u, c.u});
  if (columns_ == 1) return {0, 0};
  // The row's band, half a row wider than it is to either side, so that rounding cannot matter. The
  // outermost rows also hold what lies beyond them; there is nothing filed beyond them.
  const double pitch = scale_.v > 0 ? 1 / scale_.v : 0;
  const double bottom = low_.v + (row - 0.5) * pitch, top = low_.v + (row + 1.5) * pitch;
  double from = HUGE_VAL, to = -HUGE_VAL;
  for (const auto& [p, q] : {std::pair{a, b}, std::pair{b, c}, std::pair{c, a}}) {
    const Point2 l = p.v <= q.v ? p : q, h = p.v <= q.v ? q : p;
    if (h.v < bottom || l.v > top) continue;
    const double rise = h.v - l.v;
    const auto u_at = [&](double v) {
      if (v <= l.v || !(rise > 0)) return l.u;
      return v >= h.v ? h.u : l.u + (h.u - l.u) * ((v - l.v) / rise);
    };
    const double u0 = u_at(bottom), u1 = u_at(top);
    from = std::min({from, u0, u1});
    to = std::max({to, u0, u1});
    if (!(rise > 0)) from = std::min(from, h.u), to = std::max(to, h.u);
  }
  if (!(from <= to)) return {Column(low_u), Column(high_u)};
  const std::uint32_t first = Column(from), last = Column(to);
  return {first > 0 ? first - 1 : 0, last + 1 < columns_ ? last + 1 : columns_ - 1};
}

}  // namespace strata::io
