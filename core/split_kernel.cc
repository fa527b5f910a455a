// Triangles that cross lattice planes, cut until each part lies in one cell.
#include <algorithm>

#include "core/scan_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/split_kernel.cc"
#include <hwy/foreach_target.h>
// Must come after foreach_target.h.
#include <hwy/highway.h>

#include "core/part_bound-inl.h"

HWY_BEFORE_NAMESPACE();
namespace strata {
namespace HWY_NAMESPACE {
namespace {

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

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace strata
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace strata {

HWY_EXPORT(Split);
HWY_EXPORT(Bound);

void SplitTriangles(SplitQueue& queue, std::size_t begin, std::size_t end,
                    const ScanParameters& parameters, SplitQueue& scratch, SplitQueue& scratch2,
                    SplitParts& parts) {
  HWY_DYNAMIC_DISPATCH(Split)(queue, begin, end, parameters, scratch, scratch2, parts);
}

void BoundParts(SplitParts& parts, const ScanParameters& parameters) {
  if (parts.geometry.size > 0) HWY_DYNAMIC_DISPATCH(Bound)(parts, parameters);
}

}  // namespace strata
#endif  // HWY_ONCE
