// What the vector kernels compute with: lanes of doubles and 64-bit integers, triangles of them,
// and the twins of core/triangle_hash.h and core/random_stream.h. Only for files that Highway
// compiles once per instruction set (hwy/foreach_target.h).
#if defined(STRATA_CORE_SIMD_VECTORS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef STRATA_CORE_SIMD_VECTORS_INL_H
#undef STRATA_CORE_SIMD_VECTORS_INL_H
#else
#define STRATA_CORE_SIMD_VECTORS_INL_H
#endif

#include <hwy/highway.h>

#include "core/random_stream.h"
#include "core/scan_kernel.h"

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

HWY_INLINE Triangle3 LoadColumns(const double* const* column, std::size_t i) {
  const auto at = [&](int k) HWY_ATTR { return hn::LoadU(df, column[k] + i); };
  return {{at(0), at(1), at(2)}, {at(3), at(4), at(5)}, {at(6), at(7), at(8)}};
}

// Stores the lanes of `mask` side by side; what follows up to a full vector is garbage. Compressing
// in a register and storing all of it: the instruction that compresses into memory takes over a
// hundred cycles on some processors (AMD Zen 4).
HWY_INLINE void Pack(F v, M mask, double* to) { hn::StoreU(hn::Compress(v, mask), df, to); }
HWY_INLINE void Pack(U v, M mask, std::uint64_t* to) {
  hn::StoreU(hn::Compress(v, hn::RebindMask(du, mask)), du, to);
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace strata
HWY_AFTER_NAMESPACE();

#endif  // STRATA_CORE_SIMD_VECTORS_INL_H, per target
