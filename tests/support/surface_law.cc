#include "tests/support/surface_law.h"

#include <algorithm>
#include <cmath>

namespace strata::test {
namespace {

LongVec Mix(const LongVec& a, const LongVec& b, long double t) {
  return {a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z)};
}
LongVec Minus(const LongVec& a, const LongVec& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
LongVec CrossOf(const LongVec& a, const LongVec& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
long double LengthOf(const LongVec& a) { return std::sqrt(a.x * a.x + a.y * a.y + a.z * a.z); }

// The part on one side: sign * (coordinate - plane) >= 0.
LongPolygon ClipToHalf(const LongPolygon& in, int axis, long double plane, long double sign) {
  LongPolygon out;
  for (std::size_t i = 0; i < in.size(); ++i) {
    const LongVec &a = in[i], &b = in[(i + 1) % in.size()];
    const long double da = sign * (a[axis] - plane), db = sign * (b[axis] - plane);
    if (da >= 0) out.push_back(a);
    if ((da > 0 && db < 0) || (da < 0 && db > 0)) {
      LongVec p = Mix(a, b, da / (da - db));
      p[axis] = plane;
      out.push_back(p);
    }
  }
  return out;
}

// Adaptive integration of exp(-lambda |p|) over a triangle.
class Quadrature {
 public:
  // Parts further away than `nearest` by 40 / lambda hold nothing to speak of.
  Quadrature(double lambda, long double nearest)
      : lambda_(lambda), horizon_(lambda > 0 ? nearest + 40 / lambda : HUGE_VALL) {}

  template <class Visit>
  void Run(const LongVec& a, const LongVec& b, const LongVec& c, int depth, Visit&& visit) const {
    const long double size =
        std::max({LengthOf(Minus(a, b)), LengthOf(Minus(b, c)), LengthOf(Minus(c, a))});
    const LongVec middle = Mix(Mix(a, b, 0.5L), c, 1 / 3.0L);
    // The density has a kink at the centre.
    const long double near = std::max(0.0L, LengthOf(middle) - size);
    const bool smooth = size * lambda_ < 0.5L && size < 0.5L;
    const bool resolved = near > size || size * std::max(lambda_, 4.0) < 0.01L;
    if (near > horizon_) return;
    if (depth >= 24 || (smooth && resolved)) {
      Leaf(a, b, c, visit);
      return;
    }
    const LongVec ab = Mix(a, b, 0.5L), bc = Mix(b, c, 0.5L), ca = Mix(c, a, 0.5L);
    Run(a, ab, ca, depth + 1, visit);
    Run(ab, b, bc, depth + 1, visit);
    Run(ca, bc, c, depth + 1, visit);
    Run(ab, bc, ca, depth + 1, visit);
  }

 private:
  // Radon's rule of degree 5 on seven points.
  template <class Visit>
  void Leaf(const LongVec& a, const LongVec& b, const LongVec& c, Visit&& visit) const {
    const double area = static_cast<double>(LengthOf(CrossOf(Minus(b, a), Minus(c, a))) / 2);
    const double root = std::sqrt(15.0);
    const auto point = [&](double u, double v) {
      const double w = 1 - u - v;
      const LongVec p{w * a.x + u * b.x + v * c.x, w * a.y + u * b.y + v * c.y,
                      w * a.z + u * b.z + v * c.z};
      return p;
    };
    const auto add = [&](double u, double v, double weight) {
      const LongVec p = point(u, v);
      visit(p, weight * area * std::exp(-lambda_ * static_cast<double>(LengthOf(p))));
    };
    add(1.0 / 3, 1.0 / 3, 9.0 / 40);
    for (const double sign : {-1.0, 1.0}) {
      const double k = (6 + sign * root) / 21, w = (155 + sign * root) / 1200;
      add(k, k, w), add(1 - 2 * k, k, w), add(k, 1 - 2 * k, w);
    }
  }
  double lambda_;
  long double horizon_;
};

long double DotOf(const LongVec& a, const LongVec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Distance from the origin to a segment.
long double DistanceToSegment(const LongVec& a, const LongVec& b) {
  const LongVec d = Minus(b, a);
  const long double length2 = DotOf(d, d);
  const long double t = length2 > 0 ? std::clamp(-DotOf(a, d) / length2, 0.0L, 1.0L) : 0.0L;
  return LengthOf(Mix(a, b, t));
}

// Distance from the origin to a convex polygon.
long double DistanceTo(const LongPolygon& p) {
  const LongVec n = CrossOf(Minus(p[1], p[0]), Minus(p[2], p[0]));
  const long double n2 = DotOf(n, n), h = DotOf(n, p[0]);
  bool above = true;
  long double rim = HUGE_VALL;
  for (std::size_t i = 0; i < p.size(); ++i) {
    const LongVec &a = p[i], &b = p[(i + 1) % p.size()];
    const LongVec foot{n.x * h / n2, n.y * h / n2, n.z * h / n2};
    above = above && DotOf(n, CrossOf(Minus(b, a), Minus(foot, a))) >= 0;
    rim = std::min(rim, DistanceToSegment(a, b));
  }
  return above && n2 > 0 ? std::fabs(h) / std::sqrt(n2) : rim;
}

template <class Visit>
void Integrate(const LongPolygon& polygon, double lambda, Visit&& visit) {
  const Quadrature quadrature(lambda, DistanceTo(polygon));
  for (std::size_t i = 1; i + 1 < polygon.size(); ++i) {
    quadrature.Run(polygon[0], polygon[i], polygon[i + 1], 0, visit);
  }
}

// Borders between `count` parts of roughly equal weight. A border that falls on a value that many
// points share (a plane of constant coordinate) is moved off it.
std::vector<double> Quantiles(std::vector<std::pair<double, double>>& weighted, int count) {
  std::sort(weighted.begin(), weighted.end());
  double total = 0;
  for (const auto& w : weighted) total += w.second;
  std::vector<double> borders;
  double sum = 0;
  int next = 1;
  for (const auto& w : weighted) {
    sum += w.second;
    if (sum < total * next / count) continue;
    while (next < count && sum >= total * next / count) ++next;
    const double border = w.first + 1.2345e-5;
    if (borders.empty() || border > borders.back() + 1e-4) borders.push_back(border);
    if (next == count) break;
  }
  return borders;
}

}  // namespace

LongPolygon ClipToSlab(const LongPolygon& polygon, int axis, long double low, long double high) {
  return ClipToHalf(ClipToHalf(polygon, axis, low, 1), axis, high, -1);
}

LongPolygon ClipToBox(LongPolygon polygon, const LongVec& low, const LongVec& high) {
  for (int a = 0; a < 3 && !polygon.empty(); ++a) polygon = ClipToSlab(polygon, a, low[a], high[a]);
  return polygon;
}

long double AreaOfPolygon(const LongPolygon& p) {
  LongVec sum;
  for (std::size_t i = 1; i + 1 < p.size(); ++i) {
    const LongVec n = CrossOf(Minus(p[i], p[0]), Minus(p[i + 1], p[0]));
    sum = {sum.x + n.x, sum.y + n.y, sum.z + n.z};
  }
  return LengthOf(sum) / 2;
}

LongPolygon ToLong(const Triangle& triangle) {
  LongPolygon p;
  for (const Vec3& c : triangle) p.push_back({c.x, c.y, c.z});
  return p;
}

LongPolygon Shifted(LongPolygon polygon, const LongVec& by) {
  for (LongVec& p : polygon) p = Minus(p, by);
  return polygon;
}

double IntegralOfDensity(const LongPolygon& polygon, double lambda) {
  double sum = 0;
  Integrate(polygon, lambda, [&](const LongVec&, double mass) { sum += mass; });
  return sum;
}

Moments MomentsOf(double x, double y, double z) {
  return {std::sqrt(x * x + y * y + z * z), x, y, z};
}

CellLaw::CellLaw(const std::vector<LongPolygon>& surface, double lambda, int per_axis) {
  std::array<std::vector<std::pair<double, double>>, 3> weighted;
  Moments square{};
  for (const LongPolygon& p : surface) {
    Integrate(p, lambda, [&](const LongVec& at, double mass) {
      for (int a = 0; a < 3; ++a) {
        weighted[static_cast<std::size_t>(a)].push_back({static_cast<double>(at[a]), mass});
      }
      const Moments m = MomentsOf(static_cast<double>(at.x), static_cast<double>(at.y),
                                  static_cast<double>(at.z));
      for (std::size_t k = 0; k < kMomentCount; ++k) {
        mean_[k] += mass * m[k];
        square[k] += mass * m[k] * m[k];
      }
    });
  }
  for (std::size_t a = 0; a < 3; ++a) borders_[a] = Quantiles(weighted[a], per_axis);
  const auto edge = [&](int axis, std::size_t i) -> long double {
    const auto& b = borders_[static_cast<std::size_t>(axis)];
    return i == 0 ? -2.0L : i > b.size() ? 2.0L : b[i - 1];
  };
  const std::size_t nx = borders_[0].size() + 1, ny = borders_[1].size() + 1,
                    nz = borders_[2].size() + 1;
  probability_.assign(nx * ny * nz, 0);
  for (const LongPolygon& polygon : surface) {
    for (std::size_t x = 0; x < nx; ++x) {
      const LongPolygon in_x = ClipToSlab(polygon, 0, edge(0, x), edge(0, x + 1));
      for (std::size_t y = 0; y < ny && !in_x.empty(); ++y) {
        const LongPolygon in_y = ClipToSlab(in_x, 1, edge(1, y), edge(1, y + 1));
        for (std::size_t z = 0; z < nz && !in_y.empty(); ++z) {
          const LongPolygon part = ClipToSlab(in_y, 2, edge(2, z), edge(2, z + 1));
          if (part.size() >= 3)
            probability_[(x * ny + y) * nz + z] += IntegralOfDensity(part, lambda);
        }
      }
    }
  }
  for (const double p : probability_) mass_ += p;
  for (double& p : probability_) p /= mass_;
  for (std::size_t k = 0; k < kMomentCount; ++k) {
    mean_[k] /= mass_;
    variance_[k] = std::max(0.0, square[k] / mass_ - mean_[k] * mean_[k]);
  }
}

std::size_t CellLaw::BinOf(Vec3 local) const {
  std::size_t bin = 0;
  for (int a = 0; a < 3; ++a) {
    const auto& b = borders_[static_cast<std::size_t>(a)];
    const auto at =
        static_cast<std::size_t>(std::upper_bound(b.begin(), b.end(), local[a]) - b.begin());
    bin = bin * (b.size() + 1) + at;
  }
  return bin;
}

}  // namespace strata::test
