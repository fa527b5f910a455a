#include "core/scan_kernel.h"

#include <algorithm>
#include <cctype>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/scan_kernel.cc"
#include <hwy/foreach_target.h>
// Must come after foreach_target.h.
#include <hwy/highway.h>

#include "core/race.h"
#include "core/random_stream.h"
#include "core/simd_target.h"

HWY_BEFORE_NAMESPACE();
namespace strata {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using DF = hn::ScalableTag<double>;
using DU = hn::ScalableTag<std::uint64_t>;
using DI = hn::ScalableTag<std::int64_t>;
using F = hn::Vec<DF>;
using U = hn::Vec<DU>;
using M = hn::Mask<DF>;

constexpr DF df;
constexpr DU du;
constexpr DI di;

HWY_INLINE F Const(double v) { return hn::Set(df, v); }
HWY_INLINE U ConstU(std::uint64_t v) { return hn::Set(du, v); }

// Products of the low 32-bit halves of the 64-bit lanes.
#if HWY_TARGET == HWY_SCALAR
HWY_INLINE U MulLow32(U a, U b) {
  return ConstU((hn::GetLane(a) & 0xffffffffu) * (hn::GetLane(b) & 0xffffffffu));
}
#else
using DW = hn::Repartition<std::uint32_t, DU>;
HWY_INLINE U MulLow32(U a, U b) {
  const DW dw;
  return hn::MulEven(hn::BitCast(dw, a), hn::BitCast(dw, b));
}
#endif

// a * b modulo 2^64.
#if HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL
HWY_INLINE U Mul64(U a, std::uint64_t b) { return U{_mm512_mullo_epi64(a.raw, ConstU(b).raw)}; }
#else
HWY_INLINE U Mul64(U a, std::uint64_t b) {
  const U b_low = ConstU(b), b_high = ConstU(b >> 32);
  const U cross = hn::Add(MulLow32(hn::ShiftRight<32>(a), b_low), MulLow32(a, b_high));
  return hn::Add(MulLow32(a, b_low), hn::ShiftLeft<32>(cross));
}
#endif

struct V3 {
  F x, y, z;
};
HWY_INLINE V3 Sub(V3 a, V3 b) { return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)}; }
HWY_INLINE V3 Select(M m, V3 yes, V3 no) {
  return {hn::IfThenElse(m, yes.x, no.x), hn::IfThenElse(m, yes.y, no.y),
          hn::IfThenElse(m, yes.z, no.z)};
}
HWY_INLINE F Norm2(V3 a) {
  return hn::Add(hn::Add(hn::Mul(a.x, a.x), hn::Mul(a.y, a.y)), hn::Mul(a.z, a.z));
}
HWY_INLINE V3 Cross(V3 a, V3 b) {
  return {hn::Sub(hn::Mul(a.y, b.z), hn::Mul(a.z, b.y)),
          hn::Sub(hn::Mul(a.z, b.x), hn::Mul(a.x, b.z)),
          hn::Sub(hn::Mul(a.x, b.y), hn::Mul(a.y, b.x))};
}
struct Triangle3 {
  V3 a, b, c;
};
HWY_INLINE F AreaOf(const Triangle3& t) {
  return hn::Mul(Const(0.5), hn::Sqrt(Norm2(Cross(Sub(t.b, t.a), Sub(t.c, t.a)))));
}
HWY_INLINE V3 Min(V3 a, V3 b) { return {hn::Min(a.x, b.x), hn::Min(a.y, b.y), hn::Min(a.z, b.z)}; }
HWY_INLINE V3 Max(V3 a, V3 b) { return {hn::Max(a.x, b.x), hn::Max(a.y, b.y), hn::Max(a.z, b.z)}; }
HWY_INLINE V3 Floor(V3 a) { return {hn::Floor(a.x), hn::Floor(a.y), hn::Floor(a.z)}; }

// Twins of core/triangle_hash.h.
HWY_INLINE U HashVertex(V3 p) {
  const F zero = hn::Zero(df);
  const U x = hn::BitCast(du, hn::Add(p.x, zero)), y = hn::BitCast(du, hn::Add(p.y, zero)),
          z = hn::BitCast(du, hn::Add(p.z, zero));
  U h = Mul64(x, kHashMultipliers[0]);
  h = hn::Xor(h, hn::ShiftRight<32>(h));
  h = Mul64(hn::Add(h, y), kHashMultipliers[1]);
  h = hn::Xor(h, hn::ShiftRight<29>(h));
  h = Mul64(hn::Add(h, z), kHashMultipliers[2]);
  return hn::Xor(h, hn::ShiftRight<32>(h));
}
HWY_INLINE U HashEdge(U from, U to) {
  const U turned = hn::Or(hn::ShiftLeft<25>(to), hn::ShiftRight<39>(to));
  const U e = Mul64(hn::Xor(from, turned), kHashMultipliers[3]);
  return hn::Xor(e, hn::ShiftRight<31>(e));
}
HWY_INLINE U HashTriangle(U a, U b, U c) {
  const U s =
      Mul64(hn::Add(hn::Add(HashEdge(a, b), HashEdge(b, c)), HashEdge(c, a)), kHashMultipliers[4]);
  return hn::Xor(s, hn::ShiftRight<32>(s));
}
HWY_INLINE U Spread(U h) {
  h = Mul64(h, kHashMultipliers[0]);
  return hn::Xor(h, hn::ShiftRight<31>(h));
}

HWY_INLINE M Less(U a, U b) {
  return hn::MaskFromVec(
      hn::BitCast(df, hn::VecFromMask(di, hn::Lt(hn::BitCast(di, a), hn::BitCast(di, b)))));
}

// Twin of CanonicalFirst.
struct First {
  M b, c;
};
HWY_INLINE First CanonicalFirst(U ha, U hb, U hc) {
  return {hn::AndNot(Less(hc, hb), Less(hb, ha)), hn::And(Less(hc, ha), Less(hc, hb))};
}
HWY_INLINE Triangle3 Canonical(const Triangle3& t, First first) {
  const M b_first = first.b, c_first = first.c;
  return {Select(b_first, t.b, Select(c_first, t.c, t.a)),
          Select(b_first, t.c, Select(c_first, t.a, t.b)),
          Select(b_first, t.a, Select(c_first, t.b, t.c))};
}

// Whole numbers of magnitude below 2^51, as integers.
HWY_INLINE U ToInteger(F whole) {
  const F magic = Const(0x1.8p52);
  return hn::Sub(hn::BitCast(du, hn::Add(whole, magic)), hn::BitCast(du, magic));
}

// Twin of ToFixedArea.
HWY_INLINE U ToFixed(F area) {
  const F magic = Const(0x1p52);
  const F shifted = hn::Add(hn::Mul(area, Const(0x1p44)), magic);
  return hn::Sub(hn::BitCast(du, shifted), hn::BitCast(du, magic));
}

// Philox4x32-10 on counters held as 32-bit numbers in 64-bit lanes, whose upper halves are garbage:
// twin of RandomStream.
struct Words {
  U w0, w1, w2, w3;
};
HWY_INLINE Words Philox(U counter, U part, U index, std::uint64_t seed) {
  U c0 = counter, c1 = hn::ShiftRight<32>(counter), c2 = part, c3 = index;
  auto k0 = static_cast<std::uint32_t>(seed), k1 = static_cast<std::uint32_t>(seed >> 32);
  const U m0 = ConstU(0xD2511F53u), m1 = ConstU(0xCD9E8D57u);
  for (int round = 0; round < 10; ++round) {
    const U p0 = MulLow32(c0, m0), p1 = MulLow32(c2, m1);
    c0 = hn::Xor(hn::Xor(hn::ShiftRight<32>(p1), c1), ConstU(k0));
    c2 = hn::Xor(hn::Xor(hn::ShiftRight<32>(p0), c3), ConstU(k1));
    c1 = p1;
    c3 = p0;
    k0 += 0x9E3779B9u;
    k1 += 0xBB67AE85u;
  }
  const U low = ConstU(0xffffffffu);
  return {hn::And(c0, low), hn::And(c1, low), hn::And(c2, low), hn::And(c3, low)};
}
// Whole numbers below 2^52, from integers.
HWY_INLINE F FromInteger(U v) {
  const F magic = Const(0x1p52);
  return hn::Sub(hn::BitCast(df, hn::Or(v, hn::BitCast(du, magic))), magic);
}

HWY_INLINE F Largest(V3 v) { return hn::Max(hn::Max(v.x, v.y), v.z); }
HWY_INLINE V3 Abs(V3 v) { return {hn::Abs(v.x), hn::Abs(v.y), hn::Abs(v.z)}; }

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

HWY_INLINE F Times(F a, double b) { return hn::Mul(a, Const(b)); }
HWY_INLINE F Norm(V3 a) { return hn::Sqrt(Norm2(a)); }
HWY_INLINE F Dot(V3 a, V3 b) {
  return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}
HWY_INLINE V3 Middle(V3 low, V3 high) {
  const F half = Const(0.5);
  return {hn::Mul(hn::Add(low.x, high.x), half), hn::Mul(hn::Add(low.y, high.y), half),
          hn::Mul(hn::Add(low.z, high.z), half)};
}

// Three corners and a fourth, equal to the third where there are three.
struct Quad3 {
  V3 a, b, c, d;
};

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

HWY_INLINE Triangle3 LoadColumns(const double* const* column, std::size_t i) {
  const auto at = [&](int k) HWY_ATTR { return hn::LoadU(df, column[k] + i); };
  return {{at(0), at(1), at(2)}, {at(3), at(4), at(5)}, {at(6), at(7), at(8)}};
}

HWY_INLINE V3 IntoCells(V3 p, const Lattice& lattice, F per_edge) {
  return {hn::Mul(hn::Sub(p.x, Const(lattice.origin.x)), per_edge),
          hn::Mul(hn::Sub(p.y, Const(lattice.origin.y)), per_edge),
          hn::Mul(hn::Sub(p.z, Const(lattice.origin.z)), per_edge)};
}

// Stores the lanes of `mask` side by side; what follows up to a full vector is garbage. Compressing
// in a register and storing all of it: the instruction that compresses into memory takes over a
// hundred cycles on some processors (AMD Zen 4).
HWY_INLINE void Pack(F v, M mask, double* to) { hn::StoreU(hn::Compress(v, mask), df, to); }
HWY_INLINE void Pack(U v, M mask, std::uint64_t* to) {
  hn::StoreU(hn::Compress(v, hn::RebindMask(du, mask)), du, to);
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

// Sums of a batch, a lane each, brought together at the end in lane order.
struct LaneTotals {
  U hash_low, hash_high;
  V3 min, max;
  std::uint64_t usable;
  std::uint32_t probes;
};
HWY_INLINE LaneTotals NoTotals() {
  const F most = Const(HUGE_VAL), least = Const(-HUGE_VAL);
  return {hn::Zero(du), hn::Zero(du), {most, most, most}, {least, least, least}, 0, 0};
}

HWY_INLINE void AddToTotals(M usable, V3 low, V3 high, U hash, LaneTotals& totals) {
  const U keep = hn::BitCast(du, hn::VecFromMask(df, usable));
  totals.hash_low = hn::Add(totals.hash_low, hn::And(hash, keep));
  totals.hash_high = hn::Add(totals.hash_high, hn::And(Spread(hash), keep));
  totals.min = Select(usable, Min(totals.min, low), totals.min);
  totals.max = Select(usable, Max(totals.max, high), totals.max);
  totals.usable += hn::CountTrue(df, usable);
}

HWY_INLINE void FindProbes(M usable, U ha, U hb, U hc, const ScanParameters& parameters,
                           LaneTotals& totals) {
  const auto usable_u = hn::RebindMask(du, usable);
  for (std::size_t p = 0; p < parameters.probes.size(); ++p) {
    const U probe = ConstU(parameters.probes[p]);
    const auto hit = hn::Or(hn::Eq(ha, probe), hn::Or(hn::Eq(hb, probe), hn::Eq(hc, probe)));
    if (!hn::AllFalse(du, hn::And(hit, usable_u))) totals.probes |= 1u << p;
  }
}

template <class V, class D>
void ToLanes(V v, D d, hn::TFromD<D>* out) {
  hn::StoreU(v, d, out);
}

void Finish(const LaneTotals& totals, BatchTotals& out) {
  constexpr std::size_t kMaxLanes = 32;
  const std::size_t lanes = hn::Lanes(df);
  double column[6][kMaxLanes];
  std::uint64_t hashes[2][kMaxLanes];
  const F values[6] = {totals.min.x, totals.min.y, totals.min.z,
                       totals.max.x, totals.max.y, totals.max.z};
  for (int k = 0; k < 6; ++k) ToLanes(values[k], df, column[k]);
  ToLanes(totals.hash_low, du, hashes[0]);
  ToLanes(totals.hash_high, du, hashes[1]);
  for (std::size_t i = 0; i < lanes; ++i) {
    out.surface.low += hashes[0][i];
    out.surface.high += hashes[1][i];
    if (column[0][i] <= column[3][i]) {
      out.bounds.Add({column[0][i], column[1][i], column[2][i]});
      out.bounds.Add({column[3][i], column[4][i], column[5][i]});
    }
  }
  out.usable += totals.usable;
  out.probes_found |= totals.probes;
}

void Classify(const TriangleBatch& batch, const ScanParameters& parameters, TriangleLanes& out) {
  const std::size_t lanes = hn::Lanes(df);
  const F per_edge = Const(1 / parameters.lattice.edge);
  const F per_face = hn::Mul(per_edge, per_edge);
  const double* column[9];
  for (int k = 0; k < 9; ++k) column[k] = batch.column(k);
  LaneTotals totals = NoTotals();
  out.small.size = out.medium.size = out.inside_size = out.rare_size = 0;
  for (std::size_t i = 0; i < batch.size(); i += lanes) {
    const Triangle3 world = LoadColumns(column, i);
    const U ha = HashVertex(world.a), hb = HashVertex(world.b), hc = HashVertex(world.c);
    const U hash = HashTriangle(ha, hb, hc);
    const First first = CanonicalFirst(ha, hb, hc);
    const Triangle3 turned = Canonical(world, first);
    hn::StoreU(hash, du, out.hash.data() + i);
    const U number = hn::Or(hn::IfThenElseZero(hn::RebindMask(du, first.b), ConstU(1)),
                            hn::IfThenElseZero(hn::RebindMask(du, first.c), ConstU(2)));
    hn::StoreU(number, du, out.first.data() + i);
    const F world_area = AreaOf(turned);
    const M valid = hn::FirstN(df, batch.size() - i);
    const M usable = hn::And(
        valid, hn::And(hn::Gt(world_area, hn::Zero(df)), hn::Lt(world_area, Const(HUGE_VAL))));
    AddToTotals(usable, Min(Min(world.a, world.b), world.c), Max(Max(world.a, world.b), world.c),
                hash, totals);
    hn::StoreU(hn::IfThenElseZero(usable, world_area), df, out.world_area.data() + i);
    if (!parameters.probes.empty()) FindProbes(usable, ha, hb, hc, parameters, totals);

    const Triangle3 t{IntoCells(turned.a, parameters.lattice, per_edge),
                      IntoCells(turned.b, parameters.lattice, per_edge),
                      IntoCells(turned.c, parameters.lattice, per_edge)};
    const F area = hn::Mul(world_area, per_face);
    const Span span = SpanOf(t);
    const M near = hn::Lt(span.reach, Const(kMaxCellCoordinate));
    const M inside = hn::Le(span.crossed, Const(1));
    // Not at 2: that may be the rounding of a little more, which crosses two planes.
    const M small = hn::Lt(span.crossed, Const(2)), medium = hn::Lt(span.crossed, Const(4));
    const auto code = [](TriangleKind k) HWY_ATTR {
      return hn::BitCast(df, ConstU(static_cast<std::uint64_t>(k)));
    };
    F kind = hn::IfThenElse(medium, code(TriangleKind::kMedium), code(TriangleKind::kLarge));
    kind = hn::IfThenElse(small, code(TriangleKind::kSmall), kind);
    kind = hn::IfThenElse(inside, code(TriangleKind::kInside), kind);
    kind = hn::IfThenElse(near, kind, code(TriangleKind::kFar));
    kind = hn::IfThenElse(usable, kind, code(TriangleKind::kUnusable));
    hn::StoreU(hn::BitCast(du, kind), du, out.kind.data() + i);

    const V3 base = Select(hn::And(near, usable), span.base, {Const(0), Const(0), Const(0)});
    StoreCell(base, out.cells, i);
    const InCell in = BoundArrival(t, span, base, area, hash, hn::Zero(du), parameters);
    hn::StoreU(in.time_bound, df, out.cells.time_bound.data() + i);
    hn::StoreU(in.area, du, out.cells.area.data() + i);
    StoreHash(in.cell_hash, out.cells, i);
    const M on_lattice = hn::And(usable, near);
    const M whole = hn::And(on_lattice, inside);
    const U numbers = hn::Iota(du, i);
    Pack(numbers, whole, out.inside.data() + out.inside_size);
    out.inside_size += hn::CountTrue(df, whole);
    const M split = hn::And(on_lattice, hn::AndNot(inside, small));
    if (!hn::AllFalse(df, split)) Append(split, t, area, hash, numbers, hn::Zero(du), out.small);
    const M resplit = hn::And(on_lattice, hn::AndNot(small, medium));
    if (!hn::AllFalse(df, resplit)) {
      Append(resplit, t, area, hash, numbers, hn::Zero(du), out.medium);
    }
    const M rare = hn::AndNot(hn::Or(hn::Or(whole, split), resplit), valid);
    if (!hn::AllFalse(df, rare)) {
      Pack(numbers, rare, out.rare.data() + out.rare_size);
      out.rare_size += hn::CountTrue(df, rare);
    }
  }
  Finish(totals, out.totals);
}

// Turns the axes so that `axis` (0, 1 or 2 per lane) comes first, and back.
HWY_INLINE V3 AxisFirst(V3 p, M is_y, M is_z) {
  return {hn::IfThenElse(is_y, p.y, hn::IfThenElse(is_z, p.z, p.x)),
          hn::IfThenElse(is_y, p.z, hn::IfThenElse(is_z, p.x, p.y)),
          hn::IfThenElse(is_y, p.x, hn::IfThenElse(is_z, p.y, p.z))};
}
HWY_INLINE V3 AxisBack(V3 p, M is_y, M is_z) {
  return {hn::IfThenElse(is_y, p.z, hn::IfThenElse(is_z, p.y, p.x)),
          hn::IfThenElse(is_y, p.x, hn::IfThenElse(is_z, p.z, p.y)),
          hn::IfThenElse(is_y, p.y, hn::IfThenElse(is_z, p.x, p.z))};
}

// Where a–b meets the plane x = `plane`; the other coordinates stay between those of a and b.
HWY_INLINE V3 CutEdge(V3 a, V3 b, F plane) {
  const F t = hn::Div(hn::Sub(plane, a.x), hn::Sub(b.x, a.x));
  const F y = hn::Add(a.y, hn::Mul(t, hn::Sub(b.y, a.y)));
  const F z = hn::Add(a.z, hn::Mul(t, hn::Sub(b.z, a.z)));
  return {plane, hn::Max(hn::Min(a.y, b.y), hn::Min(y, hn::Max(a.y, b.y))),
          hn::Max(hn::Min(a.z, b.z), hn::Min(z, hn::Max(a.z, b.z)))};
}

// A vector of triangles on its way from the cut to its parts. Handing it over in memory, between
// functions that are not inlined, keeps GCC from spilling hundreds of vectors.
struct CutLanes {
  static constexpr std::size_t kLanes = HWY_MAX_BYTES / sizeof(double);
  alignas(64) double tip[3][kLanes];   // The corner that is alone on its side,
  alignas(64) double left[3][kLanes];  // and the two others, in the triangle's orientation.
  alignas(64) double right[3][kLanes];
  alignas(64) double p[3][kLanes];  // Where tip-left and tip-right meet the plane.
  alignas(64) double q[3][kLanes];
  alignas(64) double root_area[kLanes];
  alignas(64) std::uint64_t hash[kLanes], root[kLanes], path[kLanes];
  std::size_t valid;  // Lanes in use.
};
HWY_INLINE V3 LoadV3(const double (*from)[CutLanes::kLanes]) {
  return {hn::Load(df, from[0]), hn::Load(df, from[1]), hn::Load(df, from[2])};
}
HWY_INLINE void StoreV3(V3 v, double (*to)[CutLanes::kLanes]) {
  hn::Store(v.x, df, to[0]);
  hn::Store(v.y, df, to[1]);
  hn::Store(v.z, df, to[2]);
}

// The parts of `mask` are done: they lie in the cell `base`.
HWY_INLINE void Keep(M done, const Triangle3& t, V3 fourth, V3 base, F area, const InCell& in,
                     const CutLanes& from, U part, SplitParts& parts) {
  const std::size_t n = parts.geometry.size;
  Pack(in.time_bound, done, parts.cells.time_bound.data() + n);
  Pack(in.area, done, parts.cells.area.data() + n);
  Pack(area, done, parts.area.data() + n);
  StoreCell({hn::Compress(base.x, done), hn::Compress(base.y, done), hn::Compress(base.z, done)},
            parts.cells, n);
  StoreHash(hn::Compress(in.cell_hash, hn::RebindMask(du, done)), parts.cells, n);
  Pack(fourth.x, done, parts.fourth[0].data() + n);
  Pack(fourth.y, done, parts.fourth[1].data() + n);
  Pack(fourth.z, done, parts.fourth[2].data() + n);
  Append(done, t, hn::Load(df, from.root_area), hn::Load(du, from.hash), hn::Load(du, from.root),
         part, parts.geometry);
}

// Whether a part's area is more than the rounding of its corners: `reach` is the largest
// coordinate, in cells from the lattice's origin, and `root_area` that of its triangle, or what
// that has per cell. (All of a long needle may be thinner than the rounding.)
HWY_INLINE M IsReal(F area, F reach, F root_area) {
  const F least = hn::Mul(Const(0x1p-46), hn::Max(reach, Const(1)));
  const M sliver = hn::And(hn::Lt(area, hn::Mul(root_area, Const(0x1p-10))), hn::Lt(area, least));
  return hn::AndNot(sliver, hn::Gt(area, hn::Zero(df)));
}

// A triangle from a cut: keeps it if it lies in one cell, queues it if it crosses another plane.
HWY_INLINE void Place(M valid, const Triangle3& t, const CutLanes& from, std::uint64_t step,
                      const ScanParameters& parameters, SplitQueue& again, SplitParts& parts) {
  const F root_area = hn::Load(df, from.root_area);
  const U hash = hn::Load(du, from.hash);
  const U part = hn::Add(hn::Load(du, from.path), ConstU(step));
  const Span span = SpanOf(t);
  const F area = AreaOf(t);
  const M keep = hn::And(valid, IsReal(area, span.reach, root_area));
  const M inside = hn::Le(span.crossed, Const(1));
  const M more = hn::AndNot(inside, keep), done = hn::And(keep, inside);
  if (!hn::AllFalse(df, more)) {
    Append(more, t, root_area, hash, hn::Load(du, from.root), part, again);
  }
  if (hn::AllFalse(df, done)) return;
  const V3 base = Select(keep, span.base, {Const(0), Const(0), Const(0)});
  Keep(done, t, t.c, base, area, BoundArrival(t, span, base, area, hash, part, parameters), from,
       part, parts);
}

HWY_NOINLINE void PlaceTip(const CutLanes& from, const ScanParameters& parameters,
                           SplitQueue& again, SplitParts& parts) {
  Place(hn::FirstN(df, from.valid), {LoadV3(from.tip), LoadV3(from.p), LoadV3(from.q)}, from, 1,
        parameters, again, parts);
}

// The two triangles of a quadrilateral that does not lie in one cell.
HWY_NOINLINE void PlaceHalves(M apart, const CutLanes& from, const ScanParameters& parameters,
                              SplitQueue& again, SplitParts& parts) {
  const V3 p = LoadV3(from.p), right = LoadV3(from.right);
  Place(apart, {p, LoadV3(from.left), right}, from, 2, parameters, again, parts);
  Place(apart, {p, right, LoadV3(from.q)}, from, 3, parameters, again, parts);
}

// The quadrilateral p, left, right, q that a cut leaves: kept whole if it lies in one cell, else as
// two triangles.
HWY_NOINLINE void PlaceQuad(const CutLanes& from, const ScanParameters& parameters,
                            SplitQueue& again, SplitParts& parts) {
  const V3 p = LoadV3(from.p), left = LoadV3(from.left), right = LoadV3(from.right),
           q = LoadV3(from.q);
  const V3 low = Min(Min(p, left), Min(right, q)), high = Max(Max(p, left), Max(right, q));
  const V3 base = Floor(low);
  const M valid = hn::FirstN(df, from.valid);
  const M inside = hn::Le(Largest(Sub(high, base)), Const(1));
  const M apart = hn::AndNot(inside, valid);
  if (!hn::AllFalse(df, apart)) PlaceHalves(apart, from, parameters, again, parts);
  const F reach = hn::Max(Largest(Abs(low)), Largest(Abs(high)));
  const Triangle3 first{p, left, right}, second{p, right, q};
  const F area = hn::Add(AreaOf(first), AreaOf(second));
  const M done = hn::And(hn::And(valid, inside), IsReal(area, reach, hn::Load(df, from.root_area)));
  if (hn::AllFalse(df, done)) return;
  const V3 cell = Select(done, base, {Const(0), Const(0), Const(0)});
  const U part = hn::Add(hn::Load(du, from.path), ConstU(2));
  const InCell in = BoundArrival({p, left, right, q}, Middle(low, high), cell, area,
                                 hn::Load(du, from.hash), part, parameters);
  Keep(done, first, q, cell, area, in, from, part, parts);
}

// Cuts a vector of triangles along the first axis on which each crosses a plane, by the plane
// nearest the middle.
HWY_NOINLINE void Cut(const Triangle3& t, CutLanes& out) {
  const V3 low = Floor(Min(Min(t.a, t.b), t.c)), high = Max(Max(t.a, t.b), t.c);
  const F one = Const(1);
  const M cross_x = hn::Gt(hn::Sub(high.x, low.x), one);
  const M cross_y = hn::Gt(hn::Sub(high.y, low.y), one);
  const M is_y = hn::AndNot(cross_x, cross_y), is_z = hn::Not(hn::Or(cross_x, cross_y));
  const F first = AxisFirst(low, is_y, is_z).x, last = AxisFirst(high, is_y, is_z).x;
  const F plane = hn::Add(first, hn::Max(one, hn::Round(Times(hn::Sub(last, first), 0.5))));
  const V3 a = AxisFirst(t.a, is_y, is_z), b = AxisFirst(t.b, is_y, is_z),
           c = AxisFirst(t.c, is_y, is_z);
  // The corner that is alone on its side of the plane goes first; orientation stays.
  const M above_a = hn::Ge(a.x, plane), above_b = hn::Ge(b.x, plane), above_c = hn::Ge(c.x, plane);
  const M c_alone = hn::Not(hn::Xor(above_a, above_b));
  const M b_alone = hn::AndNot(c_alone, hn::Not(hn::Xor(above_a, above_c)));
  const V3 tip = Select(c_alone, c, Select(b_alone, b, a));
  const V3 left = Select(c_alone, a, Select(b_alone, c, b));
  const V3 right = Select(c_alone, b, Select(b_alone, a, c));
  StoreV3(AxisBack(tip, is_y, is_z), out.tip);
  StoreV3(AxisBack(left, is_y, is_z), out.left);
  StoreV3(AxisBack(right, is_y, is_z), out.right);
  StoreV3(AxisBack(CutEdge(tip, left, plane), is_y, is_z), out.p);
  StoreV3(AxisBack(CutEdge(tip, right, plane), is_y, is_z), out.q);
}

// Cuts every triangle of `in` [begin, end) once.
void CutOnce(SplitQueue& in, std::size_t begin, std::size_t end, const ScanParameters& parameters,
             SplitQueue& again, SplitParts& parts) {
  const std::size_t lanes = hn::Lanes(df);
  const double* column[9];
  for (std::size_t k = 0; k < 9; ++k) column[k] = in.corner[k].data();
  CutLanes cut;
  for (std::size_t i = begin; i < end; i += lanes) {
    cut.valid = std::min(lanes, end - i);
    Cut(LoadColumns(column, i), cut);
    hn::Store(hn::LoadU(df, in.root_area.data() + i), df, cut.root_area);
    hn::Store(hn::LoadU(du, in.hash.data() + i), du, cut.hash);
    hn::Store(hn::LoadU(du, in.root.data() + i), du, cut.root);
    hn::Store(hn::ShiftLeft<2>(hn::LoadU(du, in.part.data() + i)), du, cut.path);
    PlaceTip(cut, parameters, again, parts);
    PlaceQuad(cut, parameters, again, parts);
  }
}

void Split(SplitQueue& queue, std::size_t begin, std::size_t end, const ScanParameters& parameters,
           SplitQueue& scratch, SplitQueue& scratch2, SplitParts& parts) {
  parts.geometry.size = 0;
  scratch.size = 0;
  CutOnce(queue, begin, end, parameters, scratch, parts);
  SplitQueue *now = &scratch, *next = &scratch2;
  // Small triangles are done after a cut on each axis, medium ones after two.
  while (now->size > 0) {
    next->size = 0;
    CutOnce(*now, 0, now->size, parameters, *next, parts);
    std::swap(now, next);
  }
}

// Fills in what parts that were cut elsewhere lack: their bound, area and hash of the cell.
void Bound(SplitParts& parts, const ScanParameters& parameters) {
  const double* column[9];
  for (std::size_t k = 0; k < 9; ++k) column[k] = parts.geometry.corner[k].data();
  const hn::Rebind<std::int32_t, DF> narrow;
  for (std::size_t i = 0; i < parts.geometry.size; i += hn::Lanes(df)) {
    const Triangle3 t = LoadColumns(column, i);
    const V3 d{hn::LoadU(df, parts.fourth[0].data() + i), hn::LoadU(df, parts.fourth[1].data() + i),
               hn::LoadU(df, parts.fourth[2].data() + i)};
    const V3 base{hn::PromoteTo(df, hn::LoadU(narrow, parts.cells.x.data() + i)),
                  hn::PromoteTo(df, hn::LoadU(narrow, parts.cells.y.data() + i)),
                  hn::PromoteTo(df, hn::LoadU(narrow, parts.cells.z.data() + i))};
    const V3 low = Min(Min(t.a, t.b), Min(t.c, d)), high = Max(Max(t.a, t.b), Max(t.c, d));
    const F area = hn::Add(AreaOf(t), AreaOf({t.a, t.c, d}));
    const InCell in = BoundArrival({t.a, t.b, t.c, d}, Middle(low, high), base, area,
                                   hn::LoadU(du, parts.geometry.hash.data() + i),
                                   hn::LoadU(du, parts.geometry.part.data() + i), parameters);
    const F reach = hn::Max(Largest(Abs(low)), Largest(Abs(high)));
    const M real = IsReal(area, reach, hn::LoadU(df, parts.geometry.root_area.data() + i));
    hn::StoreU(hn::IfThenElse(real, in.time_bound, Const(kDroppedPart)), df,
               parts.cells.time_bound.data() + i);
    hn::StoreU(in.area, du, parts.cells.area.data() + i);
    hn::StoreU(area, df, parts.area.data() + i);
    const hn::Rebind<std::uint32_t, DU> half;
    hn::StoreU(hn::TruncateTo(half, in.cell_hash), half, parts.cells.cell_hash.data() + i);
  }
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

HWY_EXPORT(Classify);
HWY_EXPORT(Split);
HWY_EXPORT(Bound);
HWY_EXPORT(DrawAll);

namespace {
// Four running sums whatever the processor's vector length, so that it does not show in the result.
double SumInFour(const double* values, std::size_t n) {
  double sum[4] = {0, 0, 0, 0};
  std::size_t i = 0;
  for (; i + 4 <= n; i += 4) {
    for (std::size_t k = 0; k < 4; ++k) sum[k] += values[i + k];
  }
  for (; i < n; ++i) sum[i & 3] += values[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}
}  // namespace

void ClassifyTriangles(const TriangleBatch& batch, const ScanParameters& parameters,
                       TriangleLanes& lanes) {
  HWY_DYNAMIC_DISPATCH(Classify)(batch, parameters, lanes);
  lanes.totals.area += SumInFour(lanes.world_area.data(), batch.size());
}

void SplitTriangles(SplitQueue& queue, std::size_t begin, std::size_t end,
                    const ScanParameters& parameters, SplitQueue& scratch, SplitQueue& scratch2,
                    SplitParts& parts) {
  HWY_DYNAMIC_DISPATCH(Split)(queue, begin, end, parameters, scratch, scratch2, parts);
}

void BoundParts(SplitParts& parts, const ScanParameters& parameters) {
  if (parts.geometry.size > 0) HWY_DYNAMIC_DISPATCH(Bound)(parts, parameters);
}

void DrawParts(DrawLanes& lanes, std::size_t n, double lambda, std::uint64_t seed) {
  if (n > 0) HWY_DYNAMIC_DISPATCH(DrawAll)(lanes, n, lambda, seed);
}

namespace {
std::string LowerCase(std::string_view text) {
  std::string lower(text);
  for (char& c : lower) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return lower;
}
std::vector<std::int64_t> CompiledTargets() {
  std::vector<std::int64_t> targets;
  for (std::int64_t left = hwy::SupportedTargets() & HWY_TARGETS; left != 0; left &= left - 1) {
    targets.push_back(left & -left);
  }
  return targets;
}
}  // namespace

std::vector<std::string> SimdTargets() {
  std::vector<std::string> names;
  for (const std::int64_t target : CompiledTargets()) {
    names.push_back(LowerCase(hwy::TargetName(target)));
  }
  return names;
}

Result<void> ForceSimdTarget(std::string_view name) {
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
  if (name == "auto") return {};
  std::string known;
  for (const std::int64_t target : CompiledTargets()) {
    const std::string candidate = LowerCase(hwy::TargetName(target));
    known += (known.empty() ? "" : ", ") + candidate;
    if (candidate != name) continue;
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().DeInit();
    return {};
  }
  return Fail(ErrorCode::kInvalidArgument, "instruction set '" + std::string(name) +
                                               "' is not to be had here; expected auto, " + known);
}

}  // namespace strata
#endif  // HWY_ONCE
