// Where a part of a triangle lies on the lattice, and a lower bound of its first arrival. Only for
// files that Highway compiles once per instruction set (hwy/foreach_target.h).
#if defined(STRATA_CORE_PART_BOUND_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef STRATA_CORE_PART_BOUND_INL_H
#undef STRATA_CORE_PART_BOUND_INL_H
#else
#define STRATA_CORE_PART_BOUND_INL_H
#endif

#include "core/simd_vectors-inl.h"

HWY_BEFORE_NAMESPACE();
namespace strata {
namespace HWY_NAMESPACE {
namespace {

// Where a box of cell coordinates lies on the lattice.
struct Span {
  V3 low, high;
  V3 base;    // Lowest cell.
  F crossed;  // Extent above `base`: <= 1 within one cell, < 2 at most one plane on any axis.
  F reach;    // Largest coordinate.
};
HWY_INLINE Span SpanOf(const Triangle3& t) {
  const V3 low = Min(Min(t.a, t.b), t.c), high = Max(Max(t.a, t.b), t.c);
  Span span;
  span.low = low;
  span.high = high;
  span.base = Floor(low);
  span.crossed = Largest(Sub(high, span.base));
  span.reach = hn::Max(Largest(Abs(low)), Largest(Abs(high)));
  return span;
}

// Three corners and a fourth, equal to the third where there are three.
struct Quad3 {
  V3 a, b, c, d;
};

// Bounds only need single precision, which costs half as much: as many lanes of float.
using DS = hn::Rebind<float, DF>;
using S = hn::Vec<DS>;
constexpr DS ds;
struct S3 {
  S x, y, z;
};
HWY_INLINE S ConstS(float v) { return hn::Set(ds, v); }
HWY_INLINE S3 ToSingle(V3 v) {
  return {hn::DemoteTo(ds, v.x), hn::DemoteTo(ds, v.y), hn::DemoteTo(ds, v.z)};
}
HWY_INLINE S Dot(S3 a, S3 b) {
  return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}
HWY_INLINE S DistanceSquared(S3 a, S3 b) {
  const S3 d{hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
  return Dot(d, d);
}

// HullOf's distance, less what single precision may be off by.
HWY_INLINE S NearBelow(const Quad3& q, V3 center, V3 middle) {
  const S3 a = ToSingle(Sub(q.a, center)), b = ToSingle(Sub(q.b, center)),
           c = ToSingle(Sub(q.c, center)), d = ToSingle(Sub(q.d, center)),
           m = ToSingle(Sub(middle, center));
  const S radius = hn::Sqrt(hn::Max(hn::Max(DistanceSquared(a, m), DistanceSquared(b, m)),
                                    hn::Max(DistanceSquared(c, m), DistanceSquared(d, m))));
  const S along = hn::Min(hn::Min(Dot(m, a), Dot(m, b)), hn::Min(Dot(m, c), Dot(m, d)));
  const S distance = hn::Sqrt(Dot(m, m));
  // Close to the centre the quotient is all rounding, and of no use.
  const S before = hn::IfThenElseZero(hn::Gt(distance, ConstS(0.01f)), hn::Div(along, distance));
  return hn::Sub(hn::Max(hn::Sub(distance, radius), before), ConstS(1e-4f));
}

// What follows once a part is known to lie in the cell `base`; `middle` is that of its bounding
// box. The scalar draw must not use a looser bound of f on a part than this, or its arrivals could
// come before the bound.
struct InCell {
  F time_bound;
  U area;
  U cell_hash;  // In the low halves; twin of HashCell.
};
HWY_INLINE InCell BoundArrival(const Quad3& q, V3 middle, V3 base, F area, U hash, U part,
                               const ScanParameters& parameters) {
  const U offset = hn::Add(hn::Add(Mul64(ToInteger(base.x), kCellMultipliers[0]),
                                   Mul64(ToInteger(base.y), kCellMultipliers[1])),
                           Mul64(ToInteger(base.z), kCellMultipliers[2]));
  const U word = Philox(hn::Add(hash, offset), part, hn::Zero(du), parameters.seed).w0;
  // UniformFrom is at least word * 2^-32, and -ln(1-v) is at least v + v^2/2 + v^3/3.
  const S uniform = hn::DemoteTo(ds, hn::Mul(FromInteger(word), Const(0x1p-32)));
  const S third = hn::Add(ConstS(0.5f), hn::Mul(uniform, ConstS(1.0f / 3)));
  const S clock = hn::Mul(uniform, hn::Add(ConstS(1), hn::Mul(uniform, third)));
  // f <= exp(-lambda * near), and exp(y) is at least its Taylor polynomial.
  const V3 center{hn::Add(base.x, Const(0.5)), hn::Add(base.y, Const(0.5)),
                  hn::Add(base.z, Const(0.5))};
  const S near = NearBelow(q, center, middle);
  const S y = hn::Max(hn::Zero(ds), hn::Mul(near, ConstS(static_cast<float>(parameters.lambda))));
  S growth = hn::Add(ConstS(1.0f / 6), hn::Mul(y, ConstS(1.0f / 24)));
  growth = hn::Add(ConstS(0.5f), hn::Mul(y, growth));
  growth = hn::Add(ConstS(1), hn::Mul(y, growth));
  growth = hn::Add(ConstS(1), hn::Mul(y, growth));
  const F bound = hn::Div(hn::PromoteTo(df, hn::Mul(clock, growth)), area);
  return {hn::Mul(bound, Const(1 - 1e-5)), ToFixed(area), hn::ShiftRight<32>(offset)};
}
HWY_INLINE InCell BoundArrival(const Triangle3& t, const Span& span, V3 base, F area, U hash,
                               U part, const ScanParameters& parameters) {
  return BoundArrival({t.a, t.b, t.c, t.c}, Middle(span.low, span.high), base, area, hash, part,
                      parameters);
}

HWY_INLINE void StoreCell(V3 base, CellParts& out, std::size_t at) {
  const hn::Rebind<std::int32_t, DF> narrow;
  hn::StoreU(hn::DemoteTo(narrow, base.x), narrow, out.x.data() + at);
  hn::StoreU(hn::DemoteTo(narrow, base.y), narrow, out.y.data() + at);
  hn::StoreU(hn::DemoteTo(narrow, base.z), narrow, out.z.data() + at);
}

HWY_INLINE void StoreHash(U hash, CellParts& out, std::size_t at) {
  const hn::Rebind<std::uint32_t, DU> narrow;
  hn::StoreU(hn::TruncateTo(narrow, hash), narrow, out.cell_hash.data() + at);
}

// Appends the lanes of `mask` to a queue.
HWY_INLINE void Append(M mask, const Triangle3& t, F root_area, U hash, U root, U part,
                       SplitQueue& out) {
  const std::size_t n = out.size;
  Pack(t.a.x, mask, out.corner[0].data() + n);
  Pack(t.a.y, mask, out.corner[1].data() + n);
  Pack(t.a.z, mask, out.corner[2].data() + n);
  Pack(t.b.x, mask, out.corner[3].data() + n);
  Pack(t.b.y, mask, out.corner[4].data() + n);
  Pack(t.b.z, mask, out.corner[5].data() + n);
  Pack(t.c.x, mask, out.corner[6].data() + n);
  Pack(t.c.y, mask, out.corner[7].data() + n);
  Pack(t.c.z, mask, out.corner[8].data() + n);
  Pack(root_area, mask, out.root_area.data() + n);
  Pack(hash, mask, out.hash.data() + n);
  Pack(root, mask, out.root.data() + n);
  Pack(part, mask, out.part.data() + n);
  out.size = n + hn::CountTrue(df, mask);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace strata
HWY_AFTER_NAMESPACE();

#endif  // STRATA_CORE_PART_BOUND_INL_H, per target
