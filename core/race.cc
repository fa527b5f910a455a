#include "core/race.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/numeric.h"

namespace strata {
namespace {

// Squared distance from the origin to the segment a-b.
double SegmentDistance2(Vec3 a, Vec3 b) {
  const Vec3 d = b - a;
  const double length2 = Norm2(d), along = -Dot(a, d);
  if (!(along > 0)) return Norm2(a);
  if (along >= length2) return Norm2(b);
  return Norm2(a + d * (along / length2));
}

// A little more than f at distance d: rounding must not lift f above its bound.
double BoundAt(double lambda, double d) { return Exp(-lambda * d) * kAboveRounding; }

// Integral of f over the part of a plane at least `near` (>= its height) from the centre.
double MassBeyond(double lambda, double near) {
  return 2 * kPi * Exp(-lambda * near) * (near + 1 / lambda) / lambda;
}

int Next(const Polygon& piece, int i) { return i + 1 == piece.size ? 0 : i + 1; }

// Whether p, in the piece's plane, lies in the piece (corners counter-clockwise about the normal).
bool Contains(const Polygon& piece, Vec3 normal, Vec3 p) {
  for (int i = 0; i < piece.size; ++i) {
    const Vec3 a = piece[i];
    if (Dot(normal, Cross(piece[Next(piece, i)] - a, p - a)) < 0) return false;
  }
  return true;
}

// A ball about the middle of the bounding box, and a bound of the piece's distance from the
// centre: by that ball, and by the plane across the way to its middle that no corner comes before.
// The vector kernel has a twin.
struct Hull {
  double near, radius;
};
Hull HullOf(const Polygon& piece) {
  Vec3 low = piece[0], high = piece[0];
  for (int i = 1; i < piece.size; ++i) {
    const Vec3 p = piece[i];
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  const Vec3 middle = (low + high) * 0.5;
  double radius2 = 0, along = HUGE_VAL;
  for (int i = 0; i < piece.size; ++i) {
    radius2 = std::max(radius2, Norm2(piece[i] - middle));
    along = std::min(along, Dot(middle, piece[i]));
  }
  const double distance = Norm(middle), radius = std::sqrt(radius2);
  const double before = distance > 0 ? along / distance : 0;
  return {std::max(0.0, std::max(distance - radius, before)), radius};
}

// How a piece lies about the cell's centre.
struct Reach {
  double height;    // Distance of its plane.
  double near;      // Distance of its nearest point, or less.
  double far;       // Distance of its furthest corner.
  bool holds_foot;  // Whether the centre's foot on the plane is in the piece.
};
// A piece thinner than the rounding of its corners lies on no side of its edges for sure: then the
// hull still knows how near it is at least.
Reach ReachOf(const Polygon& piece, Vec3 normal, const Hull& hull) {
  Reach reach{std::fabs(Dot(normal, piece[0])), 0, 0, true};
  double near2 = HUGE_VAL, far2 = 0;
  for (int i = 0; i < piece.size; ++i) {
    const Vec3 a = piece[i], b = piece[Next(piece, i)];
    far2 = std::max(far2, Norm2(a));
    // Beyond this edge, as seen from the foot? Only such edges can hold the nearest point.
    if (Dot(normal, Cross(a, b)) >= 0) continue;
    reach.holds_foot = false;
    near2 = std::min(near2, SegmentDistance2(a, b));
  }
  reach.near = std::max(hull.near, reach.holds_foot ? reach.height : std::sqrt(near2));
  reach.far = std::sqrt(far2);
  return reach;
}

// A uniform point of the triangle a, b, c from two uniform numbers.
Vec3 UniformIn(Vec3 a, Vec3 b, Vec3 c, double r1, double r2) {
  if (r1 + r2 > 1) r1 = 1 - r1, r2 = 1 - r2;
  return a + (b - a) * r1 + (c - a) * r2;
}

// One way to propose arrivals: a total rate, and proposals with the density they are to be thinned
// by. Each gives a point and the probability of accepting it.
struct Proposal {
  Vec3 point;
  double accept;
};

// Envelope 1: constant over the piece.
class FlatEnvelope {
 public:
  FlatEnvelope(const Polygon& piece, Vec3 normal, double lambda, double area, double bound)
      : piece_(piece), normal_(normal), lambda_(lambda), bound_(bound), rate_(bound * area) {}
  double rate() const { return rate_; }
  Proposal Propose(const RandomStream::Block& block, const RandomStream::Block&) const {
    const double r1 = UniformFrom(block[2]), r2 = UniformFrom(block[3]);
    const Vec3 p = piece_.size == 3   ? UniformIn(piece_[0], piece_[1], piece_[2], r1, r2)
                   : piece_.size == 4 ? UniformInQuad(r1, r2)
                                      : UniformInFan(r1, r2);
    if (lambda_ == 0) return {p, 1};
    return {p, Exp(-lambda_ * Norm(p)) / bound_};
  }

 private:
  // As UniformInFan, without the normal: core/scan_kernel.cc has a twin.
  Vec3 UniformInQuad(double r1, double r2) const {
    const Vec3 a = piece_[0], b = piece_[1], c = piece_[2], d = piece_[3];
    const double first = Norm(Cross(b - a, c - a)), second = Norm(Cross(c - a, d - a));
    const double pick = r1 * (first + second);
    const bool in_second = pick >= first;
    const double width = in_second ? second : first;
    const double left = in_second ? pick - first : pick;
    const double r = width > 0 ? std::clamp(left / width, 0.0, 1.0) : 0;
    return in_second ? UniformIn(a, c, d, r, r2) : UniformIn(a, b, c, r, r2);
  }
  // r1 picks the triangle of the fan by area, and what is left of it serves inside.
  Vec3 UniformInFan(double r1, double r2) const {
    std::array<double, 16> cumulative{};
    double total = 0;
    for (int i = 1; i + 1 < piece_.size; ++i) {
      total += std::fabs(Dot(normal_, Cross(piece_[i] - piece_[0], piece_[i + 1] - piece_[0])));
      cumulative[static_cast<std::size_t>(i)] = total;
    }
    const double pick = r1 * total;
    int i = 1;
    while (i + 2 < piece_.size && pick >= cumulative[static_cast<std::size_t>(i)]) ++i;
    const double below = i == 1 ? 0 : cumulative[static_cast<std::size_t>(i - 1)];
    const double width = cumulative[static_cast<std::size_t>(i)] - below;
    const double r = width > 0 ? std::clamp((pick - below) / width, 0.0, 1.0) : 0;
    return UniformIn(piece_[0], piece_[i], piece_[i + 1], r, r2);
  }

  const Polygon& piece_;
  Vec3 normal_;
  double lambda_, bound_, rate_;
};

// Envelope 2: f itself over the whole plane, which is radial about the foot. With s the distance
// from the centre, r dr = s ds, so s - height is a mixture of Gamma(1) and Gamma(2).
class RadialEnvelope {
 public:
  RadialEnvelope(const Polygon& piece, Vec3 normal, double lambda, double height, double rate)
      : piece_(piece), normal_(normal), lambda_(lambda), height_(height), rate_(rate) {
    // Any direction in the plane serves; this one is well conditioned whatever the piece looks
    // like.
    const double ax = std::fabs(normal.x), ay = std::fabs(normal.y), az = std::fabs(normal.z);
    const Vec3 axis = ax <= ay && ax <= az ? Vec3{1, 0, 0}
                      : ay <= az           ? Vec3{0, 1, 0}
                                           : Vec3{0, 0, 1};
    const Vec3 u = Cross(normal, axis);
    u_ = u * (1 / Norm(u));
    v_ = Cross(normal, u_);
    foot_ = normal * Dot(normal, piece[0]);
  }
  double rate() const { return rate_; }
  Proposal Propose(const RandomStream::Block& first, const RandomStream::Block& second) const {
    const double one_over = 1 / lambda_;
    double x = NegLogOneMinus(UniformFrom(second[0], second[1])) * one_over;
    if (UniformFrom(first[3]) * (height_ + one_over) >= height_) {
      x += NegLogOneMinus(UniformFrom(second[2], second[3])) * one_over;
    }
    const double r = std::sqrt(x * (2 * height_ + x));
    if (r > 1) return {{}, 0};  // Outside every cell.
    const SinCos turn = SinCosOfTurns(UniformFrom(first[2]));
    const Vec3 p = foot_ + u_ * (r * turn.cos) + v_ * (r * turn.sin);
    return {p, Contains(piece_, normal_, p) ? 1.0 : 0.0};
  }

 private:
  const Polygon& piece_;
  Vec3 normal_, foot_, u_, v_;
  double lambda_, height_, rate_;
};

// Envelope 3: piecewise constant over triangles, split where it is loosest until it is within a
// small factor of f. For slivers and large lambda, where the other two may need any number of
// proposals.
class SplitEnvelope {
 public:
  // `area` is shared out instead of measured again: corners of a piece thinner than their rounding
  // lie on a line.
  // `most` bounds f on the whole piece, and so on every part.
  SplitEnvelope(const Polygon& piece, Vec3 normal, double lambda, double area, double most)
      : normal_(normal), lambda_(lambda), most_(most) {
    double measured = 0;
    for (int i = 1; i + 1 < piece.size; ++i) measured += FanArea(piece, i);
    for (int i = 1; i + 1 < piece.size; ++i) {
      const double share = measured > 0 ? FanArea(piece, i) / measured : 1.0 / (piece.size - 2);
      Add({piece[0], piece[i], piece[i + 1]}, share * area);
    }
    while (size_ < kMaxParts && rate_ > kEnough * lower_) SplitLoosest();
    rate_ = 0;
    for (int i = 0; i < size_; ++i) rate_ += part(i).rate;
  }
  double rate() const { return rate_; }
  Proposal Propose(const RandomStream::Block& first, const RandomStream::Block& second) const {
    double pick = UniformFrom(first[2]) * rate_;
    int i = 0;
    while (i + 1 < size_ && pick >= part(i).rate) pick -= part(i++).rate;
    const Part& chosen = part(i);
    const Vec3 p =
        UniformIn(chosen.a, chosen.b, chosen.c, UniformFrom(first[3]), UniformFrom(second[2]));
    return {p, Exp(-lambda_ * Norm(p)) / chosen.bound};
  }

 private:
  static constexpr int kMaxParts = 256;
  static constexpr double kEnough = 3;
  struct Corners {
    Vec3 a, b, c;
  };
  struct Part : Corners {
    double area = 0, bound = 0, rate = 0, lower = 0;
  };
  static double FanArea(const Polygon& piece, int i) {
    return Norm(Cross(piece[i] - piece[0], piece[i + 1] - piece[0]));
  }
  Part& part(int i) { return parts_[static_cast<std::size_t>(i)]; }
  const Part& part(int i) const { return parts_[static_cast<std::size_t>(i)]; }

  // Upper bound of f by the nearest point; lower bound of its integral by Jensen's inequality: the
  // mean distance over a triangle is at most the mean of its corners' distances.
  Part Measure(const Corners& t, double area) const {
    Part p{t, area};
    Polygon triangle;
    triangle.Push(t.a), triangle.Push(t.b), triangle.Push(t.c);
    p.bound = std::min(most_, BoundAt(lambda_, ReachOf(triangle, normal_, HullOf(triangle)).near));
    p.rate = p.bound * area;
    p.lower = area * Exp(-lambda_ * ((Norm(t.a) + Norm(t.b) + Norm(t.c)) / 3));
    return p;
  }
  void Add(const Corners& t, double area) {
    const Part p = Measure(t, area);
    parts_[static_cast<std::size_t>(size_++)] = p;
    rate_ += p.rate;
    lower_ += p.lower;
  }
  void SplitLoosest() {
    int loosest = 0;
    for (int i = 1; i < size_; ++i) {
      if (part(i).rate - part(i).lower > part(loosest).rate - part(loosest).lower) loosest = i;
    }
    const Part old = part(loosest);
    const double ab = Norm2(old.b - old.a), bc = Norm2(old.c - old.b), ca = Norm2(old.a - old.c);
    Corners t = old;
    if (bc >= ab && bc >= ca) {
      t = {old.b, old.c, old.a};
    } else if (ca >= ab) {
      t = {old.c, old.a, old.b};
    }
    const Vec3 middle = (t.a + t.b) * 0.5;
    const Part first = Measure({t.a, middle, t.c}, 0.5 * old.area);
    part(loosest) = first;
    rate_ += first.rate - old.rate;
    lower_ += first.lower - old.lower;
    Add({middle, t.b, t.c}, 0.5 * old.area);
  }

  Vec3 normal_;
  double lambda_, most_, rate_ = 0, lower_ = 0;
  int size_ = 0;
  std::array<Part, kMaxParts + 16> parts_;
};

// Runs the clock of a Poisson process of the envelope's rate, thinning its proposals, until one is
// accepted or comes too late. `first` and `second` are blocks 0 and 1.
template <class Envelope>
std::optional<Arrival> RunClock(const Envelope& envelope, RandomStream::Block first,
                                RandomStream::Block second, const RandomStream& random,
                                double rival) {
  const double rate = std::max(envelope.rate(), kLeastRate);
  double time = 0;
  for (std::uint32_t k = 2;; k += 2) {
    time += NegLogOneMinus(UniformFrom(first[0], first[1])) / rate;
    if (time > rival) return std::nullopt;
    const Proposal p = envelope.Propose(first, second);
    if (p.accept >= 1 || UniformFrom(second[0], second[1]) < p.accept) {
      return Arrival{time, p.point};
    }
    first = random(k);
    second = random(k + 1);
  }
}

// A lower bound of the integral of f over the piece: Jensen's inequality over the fan of triangles,
// or the disc about the foot that fits in. Both measure areas in the corners; where that comes to
// more than the piece's `area` it is rounding, and counts for no more than that.
double LowerMass(const Polygon& piece, Vec3 normal, double lambda, double area,
                 const Reach& reach) {
  double mass = 0, measured = 0, boundary2 = HUGE_VAL;
  for (int i = 1; i + 1 < piece.size; ++i) {
    const double part =
        0.5 * std::fabs(Dot(normal, Cross(piece[i] - piece[0], piece[i + 1] - piece[0])));
    measured += part;
    mass += part * Exp(-lambda * ((Norm(piece[0]) + Norm(piece[i]) + Norm(piece[i + 1])) / 3));
  }
  if (measured > area) mass *= area / measured;
  if (!reach.holds_foot) return mass;
  for (int i = 0; i < piece.size; ++i) {
    boundary2 = std::min(boundary2, SegmentDistance2(piece[i], piece[Next(piece, i)]));
  }
  if (kPi * (boundary2 - reach.height * reach.height) > area) return mass;
  const double disc = MassBeyond(lambda, reach.height) - MassBeyond(lambda, std::sqrt(boundary2));
  return std::max(mass, disc);
}

// Below this product of lambda and variation in distance no piece needs more than some ten
// proposals of the better envelope, in the mean.
constexpr double kTame = 6;
// An envelope is used as it is while fewer than this many proposals are expected (at worst).
constexpr double kLooseness = 12;

}  // namespace

std::optional<Arrival> DrawFirstArrival(const Polygon& piece, Vec3 normal, double area,
                                        double lambda, const RandomStream& random, double rival) {
  const RandomStream::Block first = random(0), second = random(1);
  // f <= 1, so the first proposal of any envelope comes no earlier than this.
  if (UniformFrom(first[0], first[1]) * (1 - 1e-9) > rival * area) return std::nullopt;
  if (lambda == 0) {
    return RunClock(FlatEnvelope(piece, normal, 0, area, 1), first, second, random, rival);
  }
  const Hull hull = HullOf(piece);
  if (lambda * hull.radius <= kCrude) {
    const double bound = BoundAt(lambda, hull.near);
    return RunClock(FlatEnvelope(piece, normal, lambda, area, bound), first, second, random, rival);
  }
  const Reach reach = ReachOf(piece, normal, hull);
  const double bound = BoundAt(lambda, reach.near);
  const double flat_rate = bound * area, radial_rate = MassBeyond(lambda, reach.height);
  if (lambda * (reach.far - reach.near) > kTame &&
      std::min(flat_rate, radial_rate) >
          kLooseness * LowerMass(piece, normal, lambda, area, reach)) {
    return RunClock(SplitEnvelope(piece, normal, lambda, area, bound), first, second, random,
                    rival);
  }
  if (flat_rate <= radial_rate) {
    return RunClock(FlatEnvelope(piece, normal, lambda, area, bound), first, second, random, rival);
  }
  return RunClock(RadialEnvelope(piece, normal, lambda, reach.height, radial_rate), first, second,
                  random, rival);
}

}  // namespace strata
