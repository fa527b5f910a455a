#include "core/batch_race.h"

#include <algorithm>

namespace strata {
namespace {

constexpr std::size_t kCacheCells = std::size_t{1} << 15;
constexpr std::size_t kSmallChunk = 512;  // Small triangles split at a time,
constexpr std::size_t kMediumChunk = 18;  // and medium ones.
constexpr std::size_t kPartsRoom = std::max(kSmallChunk * kSmallParts, kMediumChunk* kMediumParts);
constexpr std::size_t kGathered = 4096;  // Pieces of large triangles that are raced at a time.
constexpr std::size_t kDraws = 256;      // Contenders drawn for at a time.
constexpr std::size_t kAhead = 12;       // Cells looked up are fetched this many early.

}  // namespace

RaceTriangle PrepareTriangle(const ClassifiedBatch& in, std::size_t i, const Lattice& lattice) {
  return PrepareTriangle({in.batch.corner(i, 0), in.batch.corner(i, 1), in.batch.corner(i, 2)},
                         static_cast<int>(in.lanes.first[i]), in.lanes.hash[i], in.batch.ids()[i],
                         lattice);
}

BatchRacer::BatchRacer(ReservoirStore& store, const ScanParameters& parameters,
                       const RaceOptions& options, std::size_t capacity)
    : parameters_(parameters),
      per_edge_(1 / parameters.lattice.edge),
      per_face_(per_edge_ * per_edge_),
      sink_(store, options, kCacheCells),
      parts_(kPartsRoom),
      scratch_{SplitQueue(kPartsRoom / 3), SplitQueue(kPartsRoom / 3)},
      draws_(kDraws),
      touched_(capacity) {}

void BatchRacer::Race(const ClassifiedBatch& in) {
  pieces_ += in.lanes.inside_size;
  EnterInside(in);
  RaceSplit(in, in.lanes.small, kSmallChunk);
  RaceSplit(in, in.lanes.medium, kMediumChunk);
  RaceContenders(in);
}

void BatchRacer::RaceSplit(const ClassifiedBatch& in, SplitQueue& queue, std::size_t chunk) {
  for (std::size_t begin = 0; begin < queue.size; begin += chunk) {
    const std::size_t end = std::min(begin + chunk, queue.size);
    SplitTriangles(queue, begin, end, parameters_, scratch_[0], scratch_[1], parts_);
    CountPieces(queue, begin, end);
    EnterParts(in);
    RaceContenders(in);
  }
  parts_.geometry.size = 0;
}

// The first part of a triangle in a cell makes it a piece. A split triangle reaches over at most
// four cells on each axis: the low bits of their coordinates tell them apart.
void BatchRacer::CountPieces(SplitQueue& queue, std::size_t begin, std::size_t end) {
  for (std::size_t i = begin; i < end; ++i) touched_[queue.root[i]] = 0;
  std::uint64_t pieces = 0;
  for (std::size_t p = 0; p < parts_.geometry.size; ++p) {
    const Cell cell = parts_.cells.cell(p);
    const std::uint64_t bit = std::uint64_t{1}
                              << ((cell.x & 3) | (cell.y & 3) << 2 | (cell.z & 3) << 4);
    std::uint64_t& touched = touched_[parts_.geometry.root[p]];
    pieces += (touched & bit) == 0;
    touched |= bit;
  }
  pieces_ += pieces;
  for (std::size_t i = begin; i < end; ++i) thin_ += touched_[queue.root[i]] == 0;
}

bool BatchRacer::GatherPieces(const ClassifiedBatch& in, const RaceTriangle& triangle,
                              std::size_t i, const SlabRange& slabs, std::int32_t begin,
                              std::int32_t end, const RunContext& context) {
  return CutIntoCells(triangle, slabs, begin, end, [&](const Polygon& piece, Cell cell) {
    AddPiece(triangle, i, slabs, piece, cell);
    if (parts_.geometry.size < kGathered) return true;
    RaceGathered(in);
    return !context.cancelled() && !sink_.over_limit();
  });
}

// Appends a piece as triangles and quadrilaterals.
void BatchRacer::AddPiece(const RaceTriangle& triangle, std::size_t root, const SlabRange& slabs,
                          const Polygon& piece, Cell cell) {
  SplitQueue& geometry = parts_.geometry;
  for (int v = 1; v + 1 < piece.size; v += 2) {
    const std::size_t n = geometry.size++;
    geometry.SetCorner(n, 0, piece[0]);
    geometry.SetCorner(n, 1, piece[v]);
    geometry.SetCorner(n, 2, piece[v + 1]);
    const Vec3 fourth = piece[std::min(v + 2, piece.size - 1)];
    for (int k = 0; k < 3; ++k) parts_.fourth[static_cast<std::size_t>(k)][n] = fourth[k];
    geometry.root_area[n] = triangle.area / slabs.cells;
    geometry.hash[n] = triangle.hash;
    geometry.root[n] = root;
    geometry.part[n] = static_cast<std::uint64_t>(v / 2);
    parts_.cells.x[n] = cell.x;
    parts_.cells.y[n] = cell.y;
    parts_.cells.z[n] = cell.z;
  }
}

void BatchRacer::RaceGathered(const ClassifiedBatch& in) {
  BoundParts(parts_, parameters_);
  const std::size_t none = parts_.geometry.size;
  std::size_t last = none;  // The last part that counted.
  for (std::size_t p = 0; p < parts_.geometry.size; ++p) {
    if (parts_.cells.time_bound[p] == kDroppedPart) continue;
    pieces_ += last == none || parts_.geometry.root[p] != parts_.geometry.root[last] ||
               parts_.cells.cell(p) != parts_.cells.cell(last);
    last = p;
  }
  EnterParts(in);
  RaceContenders(in);
  parts_.geometry.size = 0;
}

void BatchRacer::EnterInside(const ClassifiedBatch& in) {
  EnterAll(in, in.lanes.cells, in.lanes.inside_size, false,
           [&](std::size_t k) { return in.lanes.inside[k]; });
}

void BatchRacer::EnterParts(const ClassifiedBatch& in) {
  EnterAll(in, parts_.cells, parts_.geometry.size, true, [](std::size_t p) { return p; });
}

// Adds areas to their cells and notes the parts that may win there. These contenders race later,
// each cell's favourite first: most others need not be drawn then.
template <class Numbers>
void BatchRacer::EnterAll(const ClassifiedBatch& in, CellParts& cells, std::size_t count,
                          bool split, Numbers&& number) {
  CellCache::View view = sink_.View();
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t place = number(k);
    const double bound = cells.time_bound[place];
    if (k + kAhead < count) {
      __builtin_prefetch(&view.index[cells.cell_hash[number(k + kAhead)] & view.mask]);
    }
    if (bound == kDroppedPart) continue;
    const Cell cell = cells.cell(place);
    std::uint32_t entry = view.Find(cell, cells.cell_hash[place]);
    if (entry == CellCache::kNone) [[unlikely]] {
      entry = Admit(in, cell, cells.cell_hash[place]);
      view = sink_.View();
    }
    LiveCell& live = view.live[entry];
    live.area = AddAreas(live.area, cells.area[place]);
    if (bound > live.time) continue;
    contenders_.push_back({bound, entry, static_cast<std::uint32_t>(place), split});
    Favour(live, static_cast<std::uint32_t>(contenders_.size() - 1));
  }
}

// An entry for a new cell; makes room first when there is none.
[[gnu::noinline]] std::uint32_t BatchRacer::Admit(const ClassifiedBatch& in, Cell cell,
                                                  std::uint32_t hash) {
  if (sink_.full()) {
    RaceContenders(in);
    sink_.Flush();
  }
  return sink_.Add(cell, hash);
}

// Each cell's favourite is drawn for first: most others need not be drawn for then.
void BatchRacer::RaceContenders(const ClassifiedBatch& in) {
  for (std::uint32_t i = 0; i < contenders_.size(); ++i) {
    if (sink_.Live(contenders_[i].entry).favourite == i) Draw(in, i);
  }
  DrawPending(in);
  for (std::uint32_t i = 0; i < contenders_.size(); ++i) {
    const LiveCell& live = sink_.Live(contenders_[i].entry);
    if (live.favourite != i && contenders_[i].bound <= live.time) Draw(in, i);
  }
  DrawPending(in);
  contenders_.clear();
}

// Makes contender number `i` its cell's favourite if it is likelier than that.
inline void BatchRacer::Favour(LiveCell& live, std::uint32_t i) {
  // A favourite left over from an earlier list points at nobody, or at another cell's contender.
  const bool has = live.favourite < i && contenders_[live.favourite].entry == contenders_[i].entry;
  if (!has || contenders_[i].bound < contenders_[live.favourite].bound) live.favourite = i;
}

// Queues a contender for the vector code if that can draw for it, else races it here.
void BatchRacer::Draw(const ClassifiedBatch& in, std::uint32_t number) {
  const Contender& contender = contenders_[number];
  if (parameters_.lambda == 0) {
    RaceHere(in, contender);
    return;
  }
  const Cell cell = sink_.Live(contender.entry).cell;
  const std::size_t n = drawn_.size();
  Vec3 corner[4];
  const int corners = CornersOf(in, contender, corner);
  const Vec3 center = CenterOf(cell);
  for (std::size_t v = 0; v < 4; ++v) {
    const Vec3 p = corner[v] - center;
    draws_.corner[3 * v][n] = p.x;
    draws_.corner[3 * v + 1][n] = p.y;
    draws_.corner[3 * v + 2][n] = p.z;
  }
  draws_.quad[n] = corners == 4;
  draws_.area[n] = AreaOf(in, contender);
  draws_.counter[n] = StreamCounter(in.lanes.hash[RootOf(contender)], cell);
  draws_.part[n] = contender.split ? parts_.geometry.part[contender.place] : 0;
  drawn_.push_back(number);
  if (drawn_.size() == kDraws) DrawPending(in);
}

void BatchRacer::DrawPending(const ClassifiedBatch& in) {
  DrawParts(draws_, drawn_.size(), parameters_.lambda, parameters_.seed);
  for (std::size_t k = 0; k < drawn_.size(); ++k) {
    const Contender& contender = contenders_[drawn_[k]];
    const ReservoirSink::Slot slot = sink_.Entry(contender.entry);
    if (draws_.settled[k] == 0) {
      if (contender.bound <= slot.live.time) RaceHere(in, contender);
    } else if (draws_.time[k] <= slot.live.time) {
      OfferSample(PrepareTriangle(in, RootOf(contender), parameters_.lattice),
                  {draws_.local[0][k], draws_.local[1][k], draws_.local[2][k]}, draws_.time[k],
                  sink_.options(), slot);
    }
  }
  drawn_.clear();
}

void BatchRacer::RaceHere(const ClassifiedBatch& in, const Contender& contender) {
  Vec3 corner[4];
  const int corners = CornersOf(in, contender, corner);
  Polygon piece;
  for (int v = 0; v < corners; ++v) piece.Push(corner[v]);
  const std::uint64_t part = contender.split ? parts_.geometry.part[contender.place] : 0;
  RacePart(PrepareTriangle(in, RootOf(contender), parameters_.lattice), piece,
           AreaOf(in, contender), static_cast<std::uint32_t>(part), sink_.options(),
           sink_.Entry(contender.entry));
}

std::size_t BatchRacer::RootOf(const Contender& contender) {
  return contender.split ? parts_.geometry.root[contender.place] : contender.place;
}

// In cells from the lattice's origin, in canonical rotation. Returns how many; the fourth of three
// equals the third.
int BatchRacer::CornersOf(const ClassifiedBatch& in, const Contender& contender, Vec3 (&out)[4]) {
  const std::size_t place = contender.place;
  if (contender.split) {
    for (int v = 0; v < 3; ++v) out[v] = parts_.geometry.Corner(place, v);
    out[3] = {parts_.fourth[0][place], parts_.fourth[1][place], parts_.fourth[2][place]};
    return out[3] == out[2] ? 3 : 4;
  }
  int v = static_cast<int>(in.lanes.first[place]);
  for (int k = 0; k < 3; ++k, v = v == 2 ? 0 : v + 1) {
    out[k] = (in.batch.corner(place, v) - parameters_.lattice.origin) * per_edge_;
  }
  out[3] = out[2];
  return 3;
}

// Cell faces.
double BatchRacer::AreaOf(const ClassifiedBatch& in, const Contender& contender) {
  if (contender.split) return parts_.area[contender.place];
  return in.lanes.world_area[contender.place] * per_face_;
}

}  // namespace strata
