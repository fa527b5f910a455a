// First arrivals on small parts, a vector of parts at a time.
#include <algorithm>

#include "core/scan_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/draw_kernel.cc"
#include <hwy/foreach_target.h>
// Must come after foreach_target.h.
#include <hwy/highway.h>

#include "core/part_bound-inl.h"
#include "core/race.h"

HWY_BEFORE_NAMESPACE();
namespace strata {
namespace HWY_NAMESPACE {
namespace {

// Twin of HullOf in core/race.cc; `middle` is that of the bounding box.
struct Hull {
  F near, radius;
};
HWY_INLINE Hull HullOf(const Quad3& q, V3 middle) {
  const F zero = hn::Zero(df);
  const F radius = hn::Sqrt(hn::Max(hn::Max(Norm2(Sub(q.a, middle)), Norm2(Sub(q.b, middle))),
                                    hn::Max(Norm2(Sub(q.c, middle)), Norm2(Sub(q.d, middle)))));
  const F along = hn::Min(hn::Min(Dot(middle, q.a), Dot(middle, q.b)),
                          hn::Min(Dot(middle, q.c), Dot(middle, q.d)));
  const F distance = Norm(middle);
  const F before = hn::IfThenElseZero(hn::Gt(distance, zero), hn::Div(along, distance));
  return {hn::Max(zero, hn::Max(hn::Sub(distance, radius), before)), radius};
}

// Twins of core/numeric.h: the same operations in the same order.
HWY_INLINE F Linear(double a, F x, double b) { return hn::Add(Const(a), Times(x, b)); }
HWY_INLINE F Exp(F x) {
  const F magic = Const(0x1.8p52);
  const F k = hn::Sub(hn::Add(Times(x, 1.44269504088896340736), magic), magic);
  const F r = hn::Sub(hn::Sub(x, Times(k, 6.93147180369123816490e-01)),
                      Times(k, 1.90821492927058770002e-10));
  const F r2 = hn::Mul(r, r), r4 = hn::Mul(r2, r2), r8 = hn::Mul(r4, r4);
  const F a = hn::Add(hn::Add(Const(1), r), hn::Mul(r2, Linear(1.0 / 2, r, 1.0 / 6)));
  const F b =
      hn::Add(Linear(1.0 / 24, r, 1.0 / 120), hn::Mul(r2, Linear(1.0 / 720, r, 1.0 / 5040)));
  const F c = hn::Add(Linear(1.0 / 40320, r, 1.0 / 362880),
                      hn::Mul(r2, Linear(1.0 / 3628800, r, 1.0 / 39916800)));
  const F d = Linear(1.0 / 479001600, r, 1.0 / 6227020800);
  const F series = hn::Add(hn::Add(a, hn::Mul(r4, b)), hn::Mul(r8, hn::Add(c, hn::Mul(r4, d))));
  const U power = hn::ShiftLeft<52>(hn::Add(ToInteger(k), ConstU(1023)));
  return hn::Mul(series, hn::BitCast(df, power));
}
HWY_INLINE F Log(F x) {
  const U bits = hn::BitCast(du, x);
  F exponent = hn::Sub(FromInteger(hn::ShiftRight<52>(bits)), Const(1023));
  F m = hn::BitCast(
      df, hn::Or(hn::And(bits, ConstU(0x000fffffffffffffULL)), ConstU(0x3ff0000000000000ULL)));
  const M large = hn::Gt(m, Const(1.41421356237309504880));
  m = hn::IfThenElse(large, Times(m, 0.5), m);
  exponent = hn::IfThenElse(large, hn::Add(exponent, Const(1)), exponent);
  const F s = hn::Div(hn::Sub(m, Const(1)), hn::Add(m, Const(1)));
  const F z = hn::Mul(s, s), z2 = hn::Mul(z, z), z4 = hn::Mul(z2, z2);
  const F a = hn::Add(Linear(1.0 / 3, z, 1.0 / 5), hn::Mul(z2, Linear(1.0 / 7, z, 1.0 / 9)));
  const F b = hn::Add(Linear(1.0 / 11, z, 1.0 / 13), hn::Mul(z2, Linear(1.0 / 15, z, 1.0 / 17)));
  const F c = Linear(1.0 / 19, z, 1.0 / 21);
  const F twice = hn::Mul(Const(2), s);
  const F series = hn::Add(
      twice, hn::Mul(hn::Mul(twice, z), hn::Add(a, hn::Mul(z4, hn::Add(b, hn::Mul(z4, c))))));
  return hn::Add(Times(exponent, 6.93147180369123816490e-01),
                 hn::Add(series, Times(exponent, 1.90821492927058770002e-10)));
}

// Twins of UniformFrom.
HWY_INLINE F Uniform53(U high, U low) {
  const F bits = hn::Add(Times(FromInteger(high), 0x1p21), FromInteger(hn::ShiftRight<11>(low)));
  return Times(bits, 0x1p-53);
}
HWY_INLINE F Uniform32(U word) { return Times(hn::Add(FromInteger(word), Const(0.5)), 0x1p-32); }

HWY_INLINE V3 Add(V3 a, V3 b) { return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)}; }
HWY_INLINE V3 Scale(V3 a, F s) { return {hn::Mul(a.x, s), hn::Mul(a.y, s), hn::Mul(a.z, s)}; }

// Twin of FlatEnvelope's choice of a point in a triangle or a quadrilateral.
HWY_INLINE V3 UniformInPart(const Triangle3& t, V3 fourth, M quad, F r1, F r2) {
  const F zero = hn::Zero(df), one = Const(1);
  const F first = Norm(Cross(Sub(t.b, t.a), Sub(t.c, t.a)));
  const F second = Norm(Cross(Sub(t.c, t.a), Sub(fourth, t.a)));
  const F pick = hn::Mul(r1, hn::Add(first, second));
  const M in_second = hn::And(quad, hn::Ge(pick, first));
  const F width = hn::IfThenElse(in_second, second, first);
  const F left = hn::IfThenElse(in_second, hn::Sub(pick, first), pick);
  const F share = hn::Max(zero, hn::Min(hn::Div(left, width), one));
  const F in_width = hn::IfThenElseZero(hn::Gt(width, zero), share);
  F u = hn::IfThenElse(quad, in_width, r1), v = r2;
  const M fold = hn::Gt(hn::Add(u, v), one);
  u = hn::IfThenElse(fold, hn::Sub(one, u), u);
  v = hn::IfThenElse(fold, hn::Sub(one, v), v);
  const V3 b = Select(in_second, t.c, t.b), c = Select(in_second, fourth, t.c);
  return Add(Add(t.a, Scale(Sub(b, t.a), u)), Scale(Sub(c, t.a), v));
}

// The parts of a vector of lanes that are not side by side.
HWY_INLINE F Gather(LaneArray<double>& column, hn::Vec<DI> at) {
  return hn::GatherIndex(df, column.data(), at);
}
HWY_INLINE V3 GatherV3(LaneArray<double>* column, hn::Vec<DI> at) {
  return {Gather(column[0], at), Gather(column[1], at), Gather(column[2], at)};
}

// Arrivals of a vector of parts, on their way from proposals to their places.
struct DrawnLanes {
  static constexpr std::size_t kLanes = HWY_MAX_BYTES / sizeof(double);
  alignas(64) double time[kLanes];
  alignas(64) double place[3][kLanes];
  alignas(64) std::uint64_t settled[kLanes];
};

// Makes proposals number [begin, end) for the parts that `lanes.open` lists, `count` of them, and
// leaves those there that are still open; returns how many.
std::size_t Propose(DrawLanes& lanes, std::size_t count, std::uint64_t begin, std::uint64_t end,
                    double lambda, std::uint64_t seed) {
  const F one = Const(1);
  std::size_t left = 0;
  DrawnLanes out;
  for (std::size_t i = 0; i < count; i += hn::Lanes(df)) {
    const M valid = hn::FirstN(df, count - i);
    const U number =
        hn::IfThenElseZero(hn::RebindMask(du, valid), hn::LoadU(du, lanes.open.data() + i));
    const hn::Vec<DI> at = hn::BitCast(di, number);
    const V3 a = GatherV3(&lanes.corner[0], at), b = GatherV3(&lanes.corner[3], at),
             c = GatherV3(&lanes.corner[6], at);
    const M quad = hn::Gt(Gather(lanes.quad, at), hn::Zero(df));
    const V3 d = Select(quad, GatherV3(&lanes.corner[9], at), c);
    const U counter = hn::GatherIndex(du, lanes.counter.data(), at);
    const U part = hn::GatherIndex(du, lanes.part.data(), at);
    const V3 middle = Middle(Min(Min(a, b), Min(c, d)), Max(Max(a, b), Max(c, d)));
    const Hull hull = HullOf({a, b, c, d}, middle);
    const F bound = Times(Exp(Times(hull.near, -lambda)), kAboveRounding);
    const F rate = hn::Max(hn::Mul(bound, Gather(lanes.area, at)), Const(kLeastRate));
    M open = hn::And(valid, hn::Le(Times(hull.radius, lambda), Const(kCrude)));
    M hits = hn::Lt(one, one);
    F clock = begin == 0 ? hn::Zero(df) : Gather(lanes.time, at);
    F time = clock;
    V3 place = middle;
    for (std::uint64_t k = begin; k < end && !hn::AllFalse(df, open); ++k) {
      const Words first = Philox(counter, part, ConstU(2 * k), seed);
      const Words second = Philox(counter, part, ConstU(2 * k + 1), seed);
      const F step = hn::Neg(Log(hn::Sub(one, Uniform53(first.w0, first.w1))));
      clock = hn::Add(clock, hn::Div(step, rate));
      const V3 p = UniformInPart({a, b, c}, d, quad, Uniform32(first.w2), Uniform32(first.w3));
      const F accept = hn::Div(Exp(Times(Norm(p), -lambda)), bound);
      const M hit = hn::And(
          open, hn::Or(hn::Ge(accept, one), hn::Lt(Uniform53(second.w0, second.w1), accept)));
      time = hn::IfThenElse(open, clock, time);
      place = Select(hit, p, place);
      hits = hn::Or(hits, hit);
      open = hn::AndNot(hit, open);
    }
    hn::Store(time, df, out.time);
    hn::Store(place.x, df, out.place[0]);
    hn::Store(place.y, df, out.place[1]);
    hn::Store(place.z, df, out.place[2]);
    hn::Store(hn::And(hn::BitCast(du, hn::VecFromMask(df, hits)), ConstU(1)), du, out.settled);
    const std::size_t in_use = std::min(hn::Lanes(df), count - i);
    for (std::size_t lane = 0; lane < in_use; ++lane) {
      const std::size_t n = lanes.open[i + lane];
      lanes.time[n] = out.time[lane];
      for (std::size_t axis = 0; axis < 3; ++axis) lanes.local[axis][n] = out.place[axis][lane];
      lanes.settled[n] = out.settled[lane];
    }
    Pack(number, open, lanes.open.data() + left);
    left += hn::CountTrue(df, open);
  }
  return left;
}

// Twin of DrawFirstArrival for small parts, up to kProposals proposals. Parts that need more of
// them are brought together again and again, so that vectors stay full.
constexpr std::uint64_t kProposals = 32;
void DrawAll(DrawLanes& lanes, std::size_t n, double lambda, std::uint64_t seed) {
  for (std::size_t i = 0; i < n; ++i) lanes.open[i] = i;
  std::uint64_t made = 0;
  for (std::uint64_t more = 2; n > 0 && made < kProposals; more = made) {
    n = Propose(lanes, n, made, made + more, lambda, seed);
    made += more;
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace strata
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace strata {

HWY_EXPORT(DrawAll);

void DrawParts(DrawLanes& lanes, std::size_t n, double lambda, std::uint64_t seed) {
  if (n > 0) HWY_DYNAMIC_DISPATCH(DrawAll)(lanes, n, lambda, seed);
}

}  // namespace strata
#endif  // HWY_ONCE
