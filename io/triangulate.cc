#include "io/triangulate.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory_resource>
#include <optional>

#include "io/corner_grid.h"

namespace strata::io {
namespace {

using Triangles = std::vector<std::array<std::uint32_t, 3>>;

// Numbers with a magnitude above this could overflow in a product of two differences.
constexpr double kHugeSum = 1e140;

int Compare(Vec3 a, Vec3 b) {
  if (a.x != b.x) return a.x < b.x ? -1 : 1;
  if (a.y != b.y) return a.y < b.y ? -1 : 1;
  if (a.z != b.z) return a.z < b.z ? -1 : 1;
  return 0;
}

// The corner from which the cyclic sequence of coordinates is lexicographically smallest: two
// candidates are compared, and the loser skips past everything that was equal, which makes it
// linear.
std::size_t CanonicalStart(std::span<const Vec3> corners) {
  const std::size_t n = corners.size();
  const auto at = [&](std::size_t i) { return corners[i < n ? i : i - n]; };
  std::size_t i = 0, j = 1, equal = 0;
  while (i < n && j < n && equal < n) {
    const int order = Compare(at(i + equal), at(j + equal));
    if (order == 0) {
      ++equal;
      continue;
    }
    std::size_t& loser = order > 0 ? i : j;
    loser += equal + 1;
    if (i == j) ++j;
    equal = 0;
  }
  return std::min(i, j);
}

enum class Reach { kSmall, kHuge, kNonFinite };

Reach ReachOf(std::span<const Vec3> corners) {
  double largest = 0;
  for (const Vec3& p : corners) {
    // A sum of magnitudes is NaN or infinite when a part is; it may be infinite when none is.
    const double sum = std::fabs(p.x) + std::fabs(p.y) + std::fabs(p.z);
    if (!(sum <= kHugeSum)) {
      if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) {
        return Reach::kNonFinite;
      }
      largest = HUGE_VAL;
    }
  }
  return largest > 0 ? Reach::kHuge : Reach::kSmall;
}

// How a polygon is looked at: two axes of space, ordered so that it turns counter-clockwise.
struct View {
  int u = 0, v = 1;
  Point2 operator()(Vec3 p) const { return {p[u], p[v]}; }
};

// None if the polygon has no area that a normal could be told from.
std::optional<View> ViewAlongNormal(std::span<const Vec3> corners, std::size_t start) {
  const std::size_t n = corners.size();
  const Vec3 origin = corners[start];
  Vec3 normal;
  std::size_t i = start + 1 == n ? 0 : start + 1;
  Vec3 previous = corners[i] - origin;
  for (std::size_t k = 2; k < n; ++k) {
    i = i + 1 == n ? 0 : i + 1;
    const Vec3 current = corners[i] - origin;
    normal = normal + Cross(previous, current);
    previous = current;
  }
  const Vec3 size{std::fabs(normal.x), std::fabs(normal.y), std::fabs(normal.z)};
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  if (!(size[axis] > 0)) return std::nullopt;
  View view{(axis + 1) % 3, (axis + 2) % 3};
  if (normal[axis] < 0) std::swap(view.u, view.v);
  return view;
}

void Fan(std::size_t n, std::size_t start, Triangles& out) {
  const auto at = [&](std::size_t k) {
    return static_cast<std::uint32_t>(start + k < n ? start + k : start + k - n);
  };
  for (std::size_t k = 1; k + 1 < n; ++k) out.push_back({at(0), at(k), at(k + 1)});
}

// A diagonal is good if both triangles beside it turn the way the quad does; for a concave quad
// that leaves the one at the reflex corner.
void CutQuad(std::span<const Vec3> corners, std::size_t start, Triangles& out) {
  const std::array<std::uint32_t, 4> k = {
      static_cast<std::uint32_t>(start), static_cast<std::uint32_t>((start + 1) % 4),
      static_cast<std::uint32_t>((start + 2) % 4), static_cast<std::uint32_t>((start + 3) % 4)};
  bool good02 = true, good13 = true;
  if (const std::optional<View> view = ViewAlongNormal(corners, start)) {
    std::array<Point2, 4> p;
    for (std::size_t i = 0; i < 4; ++i) p[i] = (*view)(corners[k[i]]);
    good02 = Turn(p[0], p[1], p[2]) > 0 && Turn(p[0], p[2], p[3]) > 0;
    good13 = Turn(p[0], p[1], p[3]) > 0 && Turn(p[1], p[2], p[3]) > 0;
  }
  const bool cut02 = good02 != good13 ? good02
                                      : Norm2(corners[k[2]] - corners[k[0]]) <=
                                            Norm2(corners[k[3]] - corners[k[1]]);
  if (cut02) {
    out.push_back({k[0], k[1], k[2]});
    out.push_back({k[0], k[2], k[3]});
  } else {
    out.push_back({k[0], k[1], k[3]});
    out.push_back({k[1], k[2], k[3]});
  }
}

// Cuts ears off a polygon. In a simple polygon a corner that is no ear can become one only when a
// neighbour goes, so a queue that takes up the neighbours of every ear cut finds them all, and
// taking turns round the outline keeps the triangles round.
class EarClipper {
 public:
  EarClipper(std::span<const Vec3> corners, std::size_t start, View view,
             std::pmr::memory_resource* memory)
      : n_(static_cast<std::uint32_t>(corners.size())),
        start_(static_cast<std::uint32_t>(start)),
        left_(n_),
        work_left_(std::int64_t{kWorkPerCorner} * n_),
        points_(n_, memory),
        next_(n_, memory),
        previous_(n_, memory),
        state_(n_, State::kIdle, memory),
        queue_(memory),
        grid_(memory) {
    for (std::uint32_t i = 0; i < n_; ++i) {
      points_[i] = view(corners[Original(i)]);
      next_[i] = i + 1 < n_ ? i + 1 : 0;
      previous_[i] = i > 0 ? i - 1 : n_ - 1;
    }
    queue_.reserve(n_);
  }

  void Run(Triangles& out) {
    CutDegenerate(out);
    std::pmr::vector<std::uint32_t> blockers(queue_.get_allocator());
    for (std::uint32_t i = first_, k = 0; k < left_; i = next_[i], ++k) {
      if (TurnAt(i) <= 0) blockers.push_back(i);
      Enqueue(i);
    }
    grid_.Build(points_, blockers);
    while (left_ > 3 && work_left_ > 0) {
      if (head_ == queue_.size()) {
        CutAny(out);
        continue;
      }
      const std::uint32_t ear = Dequeue();
      if (state_[ear] == State::kGone || !IsEar(ear)) continue;
      Cut(ear, out);
    }
    FanOfRest(out);
  }

 private:
  enum class State : std::uint8_t { kIdle, kQueued, kGone };
  static constexpr int kWorkPerCorner = 1024;

  std::uint32_t Original(std::uint32_t i) const {
    return static_cast<std::uint32_t>((std::uint64_t{i} + start_) % n_);
  }
  double TurnAt(std::uint32_t i) const {
    return Turn(points_[previous_[i]], points_[i], points_[next_[i]]);
  }
  void Enqueue(std::uint32_t i) {
    if (state_[i] != State::kIdle) return;
    state_[i] = State::kQueued;
    queue_.push_back(i);
  }
  std::uint32_t Dequeue() {
    const std::uint32_t i = queue_[head_++];
    if (state_[i] == State::kQueued) state_[i] = State::kIdle;
    if (head_ >= n_) {
      queue_.erase(queue_.begin(), queue_.begin() + static_cast<std::ptrdiff_t>(head_));
      head_ = 0;
    }
    return i;
  }
  void Emit(std::uint32_t a, std::uint32_t b, std::uint32_t c, Triangles& out) const {
    out.push_back({Original(a), Original(b), Original(c)});
  }

  void Remove(std::uint32_t i, Triangles& out) {
    const std::uint32_t a = previous_[i], c = next_[i];
    Emit(a, i, c, out);
    next_[a] = c;
    previous_[c] = a;
    state_[i] = State::kGone;
    if (first_ == i) first_ = c;
    --left_;
  }
  void Cut(std::uint32_t i, Triangles& out) {
    const std::uint32_t a = previous_[i], c = next_[i];
    Remove(i, out);
    Enqueue(a);
    Enqueue(c);
  }

  // A corner that coincides with a neighbour, or the tip of a spike without area.
  bool IsDegenerate(std::uint32_t i) const {
    const Point2 a = points_[previous_[i]], b = points_[i], c = points_[next_[i]];
    return Turn(a, b, c) == 0 && (a.u - b.u) * (c.u - b.u) + (a.v - b.v) * (c.v - b.v) >= 0;
  }

  // Removes degenerate corners first: they would block every ear that touches them.
  void CutDegenerate(Triangles& out) {
    std::uint32_t i = first_;
    for (std::uint32_t clean = 0; clean < left_ && left_ > 3;) {
      if (IsDegenerate(i)) {
        const std::uint32_t back = previous_[i];
        Remove(i, out);
        i = back;
        clean = clean > 0 ? clean - 1 : 0;
      } else {
        i = next_[i];
        ++clean;
      }
    }
  }

  // True if an edge from `q`, which lies on the triangle's corner `at`, leads into the triangle.
  bool LeadsInside(std::uint32_t q, Point2 at, Point2 right, Point2 left) const {
    const auto inside = [&](Point2 p) { return Turn(at, right, p) > 0 && Turn(at, p, left) > 0; };
    return inside(points_[next_[q]]) || inside(points_[previous_[q]]);
  }

  bool Blocks(std::uint32_t q, std::uint32_t ia, std::uint32_t ib, std::uint32_t ic) const {
    if (q == ia || q == ib || q == ic) return false;
    const Point2 p = points_[q], a = points_[ia], b = points_[ib], c = points_[ic];
    if (!(Turn(a, b, p) >= 0 && Turn(b, c, p) >= 0 && Turn(c, a, p) >= 0)) return false;
    if (p == a) return LeadsInside(q, a, b, c);
    if (p == b) return LeadsInside(q, b, c, a);
    if (p == c) return LeadsInside(q, c, a, b);
    return true;
  }

  bool IsEar(std::uint32_t i) {
    const std::uint32_t a = previous_[i], c = next_[i];
    if (!(TurnAt(i) > 0)) return IsDegenerate(i);
    return !grid_.AnyInTriangle(
        points_[a], points_[i], points_[c], work_left_,
        [&](std::uint32_t q) { return state_[q] == State::kGone || TurnAt(q) > 0; },
        [&](std::uint32_t q) { return Blocks(q, a, i, c); });
  }

  // No ear is left: the polygon is not simple. Cuts the next corner that at least turns the right
  // way, or any.
  void CutAny(Triangles& out) {
    std::uint32_t i = first_;
    for (std::uint32_t k = 0; k < left_ && !(TurnAt(i) > 0); ++k, --work_left_) i = next_[i];
    first_ = next_[i];
    Cut(i, out);
  }

  void FanOfRest(Triangles& out) const {
    for (std::uint32_t b = next_[first_]; next_[b] != first_; b = next_[b]) {
      Emit(first_, b, next_[b], out);
    }
  }

  std::uint32_t n_, start_, left_, first_ = 0;
  std::int64_t work_left_;
  std::pmr::vector<Point2> points_;  // From the canonical start on.
  std::pmr::vector<std::uint32_t> next_, previous_;
  std::pmr::vector<State> state_;
  std::pmr::vector<std::uint32_t> queue_;
  std::size_t head_ = 0;
  CornerGrid grid_;
};

}  // namespace

void TriangulatePolygon(std::span<const Vec3> corners, Triangles& out) {
  const std::size_t n = corners.size();
  if (n < 3) return;
  if (n == 3) {
    out.push_back({0, 1, 2});
    return;
  }
  const Reach reach = ReachOf(corners);
  if (reach == Reach::kNonFinite) return Fan(n, 0, out);
  const std::size_t start = CanonicalStart(corners);
  if (reach == Reach::kHuge) return Fan(n, start, out);
  if (n == 4) return CutQuad(corners, start, out);
  const std::optional<View> view = ViewAlongNormal(corners, start);
  if (!view) return Fan(n, start, out);
  std::array<std::byte, 4096> stack;
  std::pmr::monotonic_buffer_resource memory(stack.data(), stack.size());
  EarClipper(corners, start, *view, &memory).Run(out);
}

}  // namespace strata::io
