#include "core/enclosing_ball.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <list>
#include <span>

#include "core/triangle_hash.h"

namespace strata {
namespace {

constexpr double kSlack = 1 + 1e-12;  // Relative to the squared radius: rounding, not geometry.
constexpr double kOnSphere = 1e-9;    // Relative to the radius.

bool Holds(const Ball& ball, Vec3 p) {
  return Norm2(p - ball.center) <= ball.radius * ball.radius * kSlack;
}

// Solves the symmetric n×n system (n <= 3) by Gaussian elimination with pivoting; false if
// singular.
bool Solve(std::array<std::array<double, 4>, 3>& m, int n, std::array<double, 3>& x) {
  const auto at = [&](int r, int c) -> double& {
    return m[static_cast<std::size_t>(r)][static_cast<std::size_t>(c)];
  };
  for (int c = 0; c < n; ++c) {
    int pivot = c;
    for (int r = c + 1; r < n; ++r) {
      if (std::fabs(at(r, c)) > std::fabs(at(pivot, c))) pivot = r;
    }
    std::swap(m[static_cast<std::size_t>(c)], m[static_cast<std::size_t>(pivot)]);
    if (!(std::fabs(at(c, c)) > 0)) return false;
    for (int r = c + 1; r < n; ++r) {
      const double f = at(r, c) / at(c, c);
      for (int k = c; k < 4; ++k) at(r, k) -= f * at(c, k);
    }
  }
  for (int r = n - 1; r >= 0; --r) {
    double v = at(r, 3);
    for (int k = r + 1; k < n; ++k) v -= at(r, k) * x[static_cast<std::size_t>(k)];
    x[static_cast<std::size_t>(r)] = v / at(r, r);
  }
  return true;
}

// The smallest ball with all of `on` (at most 4) on its sphere: its centre lies in their affine
// hull.
bool BallThrough(const std::vector<Vec3>& on, Ball& ball) {
  if (on.empty()) return false;
  const int n = static_cast<int>(on.size()) - 1;
  std::array<std::array<double, 4>, 3> m{};
  for (int i = 0; i < n; ++i) {
    const Vec3 a = on[static_cast<std::size_t>(i + 1)] - on[0];
    auto& row = m[static_cast<std::size_t>(i)];
    for (int j = 0; j < n; ++j) {
      row[static_cast<std::size_t>(j)] = 2 * Dot(a, on[static_cast<std::size_t>(j + 1)] - on[0]);
    }
    row[3] = Dot(a, a);
  }
  std::array<double, 3> x{};
  if (!Solve(m, n, x)) return false;
  Vec3 offset;
  for (int i = 0; i < n; ++i) {
    offset =
        offset + (on[static_cast<std::size_t>(i + 1)] - on[0]) * x[static_cast<std::size_t>(i)];
  }
  ball.center = on[0] + offset;
  ball.radius = Norm(offset);
  return std::isfinite(ball.radius);
}

// Welzl's recursion: the smallest ball around the first `count` points with `on` on its sphere.
Ball Welzl(std::list<Vec3>& points, std::list<Vec3>::iterator end, std::vector<Vec3>& on) {
  Ball ball;
  bool valid = BallThrough(on, ball);
  if (on.size() == 4) return ball;
  for (auto it = points.begin(); it != end;) {
    const auto next = std::next(it);
    if (!valid || !Holds(ball, *it)) {
      on.push_back(*it);
      Ball larger;
      if (BallThrough(on, larger)) {
        ball = Welzl(points, it, on);
        valid = true;
        points.splice(points.begin(), points, it);
      }
      on.pop_back();
    }
    it = next;
  }
  return ball;
}

// Into an order that is a function of the set, and random enough for Welzl's expected time.
void SortUnique(std::vector<Vec3>& points) {
  const auto less = [](const Vec3& a, const Vec3& b) {
    const std::uint64_t ha = HashVertex(a), hb = HashVertex(b);
    if (ha != hb) return ha < hb;
    return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.z < b.z;
  };
  std::sort(points.begin(), points.end(), less);
  points.erase(std::unique(points.begin(), points.end()), points.end());
}

// One pass that finds, per direction of a coarse compass, the point furthest outside a ball.
class Outliers {
 public:
  explicit Outliers(const Ball& ball) : ball_(ball) {
    threshold_ = ball.radius * ball.radius * kSlack;
    furthest_.fill(threshold_);
  }
  void Visit(Vec3 p) {
    const Vec3 d = p - ball_.center;
    const double distance2 = Norm2(d);
    if (!(distance2 > threshold_)) return;
    std::size_t sector = (d.x > 0 ? 1u : 0u) | (d.y > 0 ? 2u : 0u) | (d.z > 0 ? 4u : 0u);
    const double ax = std::fabs(d.x), ay = std::fabs(d.y), az = std::fabs(d.z);
    sector += ax >= ay && ax >= az ? 0 : ay >= az ? 8 : 16;
    if (distance2 <= furthest_[sector]) return;
    furthest_[sector] = distance2;
    point_[sector] = p;
  }
  void AppendTo(std::vector<Vec3>& core) const {
    for (std::size_t s = 0; s < point_.size(); ++s) {
      if (furthest_[s] > threshold_) core.push_back(point_[s]);
    }
  }

 private:
  const Ball& ball_;
  double threshold_;
  std::array<double, 24> furthest_;
  std::array<Vec3, 24> point_;
};

template <class T, class F>
void ForEachFinite(std::span<const T> xyz, F&& visit) {
  for (std::size_t i = 0; i + 2 < xyz.size(); i += 3) {
    const Vec3 p{xyz[i], xyz[i + 1], xyz[i + 2]};
    if (std::isfinite(p.x + p.y + p.z)) visit(p);
  }
}

// Grows a ball around the points of `for_each` until it holds them all.
template <class ForEach>
Result<Ball> GrowBall(Vec3 start, ForEach&& for_each) {
  std::vector<Vec3> core{start};
  Ball ball{start, 0};
  // Each round either ends or makes the ball strictly larger; the bound is for rounding alone.
  for (int round = 0; round < 64; ++round) {
    Outliers outliers(ball);
    Result<void> pass = for_each([&](Vec3 p) { outliers.Visit(p); });
    if (!pass) return Forward(pass);
    const std::size_t before = core.size();
    outliers.AppendTo(core);
    if (core.size() == before) break;
    const Ball next = EnclosingBall(core);
    if (!(next.radius > ball.radius)) break;
    ball = next;
    // Only points on or near the sphere can matter later on.
    std::erase_if(core, [&](Vec3 p) { return Norm(p - next.center) < 0.9 * next.radius; });
  }
  return ball;
}

Ball GrowBall(const std::vector<Vec3>& points) {
  return *GrowBall(points[0], [&](auto&& visit) -> Result<void> {
    for (const Vec3& p : points) visit(p);
    return {};
  });
}

// The points that can lie on the smallest ball around all points of `for_each`, from three passes.
// With c0, r0 the ball around some of them and D the greatest distance from c0, the centre is
// within sqrt(D^2 - r0^2) of c0, so points nearer to c0 than r0 less that cannot touch the sphere.
template <class ForEach>
Result<std::vector<Vec3>> MayTouchSphere(ForEach&& for_each) {
  constexpr std::size_t kSubset = 8192;
  std::vector<Vec3> subset;
  std::size_t stride = 1, count = 0;
  Result<void> pass = for_each([&](Vec3 p) {
    if ((count++ & (stride - 1)) != 0) return;  // The stride is a power of two.
    subset.push_back(p);
    if (subset.size() < kSubset) return;
    for (std::size_t i = 0; 2 * i < subset.size(); ++i) subset[i] = subset[2 * i];
    subset.resize((subset.size() + 1) / 2);
    stride *= 2;
  });
  if (!pass) return Forward(pass);
  if (stride == 1) return subset;
  const Ball inner = GrowBall(subset);
  double furthest2 = 0;
  pass = for_each([&](Vec3 p) { furthest2 = std::max(furthest2, Norm2(p - inner.center)); });
  if (!pass) return Forward(pass);
  const double shift = std::sqrt(std::max(0.0, furthest2 - inner.radius * inner.radius));
  const double near = std::max(0.0, (inner.radius - shift) * (1 - 1e-9));
  std::vector<Vec3> outer;
  pass = for_each([&](Vec3 p) {
    if (Norm2(p - inner.center) >= near * near) outer.push_back(p);
  });
  if (!pass) return Forward(pass);
  return outer;
}

template <class ForEach>
Result<StreamedBall> BallAround(ForEach&& for_each) {
  const Result<std::vector<Vec3>> points = MayTouchSphere(for_each);
  if (!points) return Forward(points);
  if (points->empty()) return Fail(ErrorCode::kEmptySurface, "no point to enclose");
  const Ball ball = GrowBall(*points);
  StreamedBall result;
  for (const Vec3& p : *points) {
    if (Norm(p - ball.center) >= ball.radius * (1 - kOnSphere)) result.support.push_back(p);
  }
  SortUnique(result.support);
  result.ball = EnclosingBall(result.support);
  return result;
}

}  // namespace

Ball EnclosingBall(std::vector<Vec3> points) {
  SortUnique(points);
  std::list<Vec3> sequence(points.begin(), points.end());
  std::vector<Vec3> on;
  return Welzl(sequence, sequence.end(), on);
}

Result<StreamedBall> EnclosingBallOfStream(const PointPass& for_each_point) {
  return BallAround(for_each_point);
}

Result<StreamedBall> EnclosingBallOfVertices(const VertexView& vertices) {
  const auto for_each = [&](auto&& visit) -> Result<void> {
    ForEachFinite(vertices.f32, visit);
    ForEachFinite(vertices.f64, visit);
    return {};
  };
  return BallAround(for_each);
}

}  // namespace strata
