#include "core/scan_kernel.h"

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/scan_kernel.cc"
#include <hwy/foreach_target.h>
// Must come after foreach_target.h.
#include <hwy/highway.h>

#include "core/part_bound-inl.h"

HWY_BEFORE_NAMESPACE();
namespace strata {
namespace HWY_NAMESPACE {
namespace {

HWY_INLINE V3 IntoCells(V3 p, const Lattice& lattice, F per_edge) {
  return {hn::Mul(hn::Sub(p.x, Const(lattice.origin.x)), per_edge),
          hn::Mul(hn::Sub(p.y, Const(lattice.origin.y)), per_edge),
          hn::Mul(hn::Sub(p.z, Const(lattice.origin.z)), per_edge)};
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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace strata
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace strata {

HWY_EXPORT(Classify);

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

}  // namespace strata
#endif  // HWY_ONCE
