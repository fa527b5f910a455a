#include "core/rejection.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <queue>
#include <utility>

namespace strata {
namespace {

using Index = std::uint32_t;
using Pair = std::pair<Index, Index>;
constexpr Index kNone = 0xffffffff;

// Hash cells per distance. With cells of twice the distance, whatever lies within the distance of a
// point is in its own cell or in one of the seven on its nearer sides; the last digit leaves room
// for the rounding of large coordinates.
constexpr double kScale = 0.499;

// Points in buckets of a spatial hash.
class SpatialHash {
 public:
  SpatialHash(std::span<const Vec3> position, double distance)
      : position_(position),
        head_(std::bit_ceil(position.size() * 4 + kBlockSize)),
        next_(position.size()) {
    Bounds bounds;
    for (const Vec3& p : position) bounds.Add(p);
    origin_ = bounds.min;
    const Vec3 side = bounds.max - bounds.min;
    // Coarser cells are right as well; finer ones than this would have numbers beyond integers.
    scale_ = kScale / std::max({distance, 0x1p-40 * side.x, 0x1p-40 * side.y, 0x1p-40 * side.z});
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, head_.size(), 1 << 14),
                      [&](const auto& r) {
                        for (auto i = r.begin(); i != r.end(); ++i) {
                          head_[i].store(kNone, std::memory_order_relaxed);
                        }
                      });
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, position.size(), 1 << 12),
                      [&](const auto& r) {
                        for (auto i = r.begin(); i != r.end(); ++i) Insert(static_cast<Index>(i));
                      });
  }

  // Calls `found(j)` for every point j < i closer to i than the distance whose square is given;
  // may call it twice for one j where two of the cells share a bucket.
  template <class F>
  void ForEarlierNeighbours(Index i, double distance2, F&& found) const {
    const Vec3 p = position_[i], scaled = Scaled(p);
    const Side x[2] = {Near(scaled.x, 0), Far(scaled.x, 0)};
    const Side y[2] = {Near(scaled.y, 1), Far(scaled.y, 1)};
    const Side z[2] = {Near(scaled.z, 2), Far(scaled.z, 2)};
    for (int n = 0; n < 8; ++n) {
      const std::size_t bucket = Bucket(x[n & 1], y[n >> 1 & 1], z[n >> 2]);
      for (Index j = head_[bucket].load(std::memory_order_relaxed); j != kNone; j = next_[j]) {
        if (j < i && Norm2(position_[j] - p) < distance2) found(j);
      }
    }
  }

 private:
  Vec3 Scaled(Vec3 p) const { return (p - origin_) * scale_; }

  // One coordinate's share of a bucket's number. Buckets of a block of 4^3 hash cells stand side by
  // side, so that neighbours share cache lines.
  struct Side {
    std::uint64_t block;
    std::size_t local;
  };
  static constexpr std::size_t kBlockSize = 64;
  static Side SideOf(std::int64_t cell, int axis) {
    constexpr std::uint64_t kSpread[3] = {0x9e3779b97f4a7c15ULL, 0xbb67ae8584caa73bULL,
                                          0x8cb92ba72f3d8dd7ULL};
    return {static_cast<std::uint64_t>(cell >> 2) * kSpread[axis],
            static_cast<std::size_t>(cell & 3) << (2 * axis)};
  }
  // The cell of a coordinate (>= 0, so truncation is the floor), and its neighbour on the nearer
  // side.
  static Side Near(double v, int axis) { return SideOf(static_cast<std::int64_t>(v), axis); }
  static Side Far(double v, int axis) {
    const auto cell = static_cast<std::int64_t>(v);
    return SideOf(v - static_cast<double>(cell) < 0.5 ? cell - 1 : cell + 1, axis);
  }
  std::size_t Bucket(Side x, Side y, Side z) const {
    const std::uint64_t block = (x.block + y.block + z.block) >> 30;
    return (block * kBlockSize + (x.local | y.local | z.local)) & (head_.size() - 1);
  }
  void Insert(Index i) {
    const Vec3 scaled = Scaled(position_[i]);
    const std::size_t bucket = Bucket(Near(scaled.x, 0), Near(scaled.y, 1), Near(scaled.z, 2));
    next_[i] = head_[bucket].exchange(i, std::memory_order_relaxed);
  }

  std::span<const Vec3> position_;
  double scale_;
  Vec3 origin_;
  std::vector<std::atomic<Index>> head_;
  std::vector<Index> next_;
};

// All pairs closer than the distance, (larger, smaller), sorted, each once.
std::vector<Pair> FindConflicts(std::span<const Vec3> position, double distance) {
  const SpatialHash hash(position, distance);
  const double distance2 = distance * distance;
  tbb::enumerable_thread_specific<std::vector<Pair>> found;
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, position.size(), 1 << 11), [&](const auto& r) {
        auto& mine = found.local();
        for (auto i = r.begin(); i != r.end(); ++i) {
          const auto a = static_cast<Index>(i);
          hash.ForEarlierNeighbours(a, distance2, [&](Index b) { mine.emplace_back(a, b); });
        }
      });
  std::vector<Pair> all;
  for (const auto& part : found) all.insert(all.end(), part.begin(), part.end());
  tbb::parallel_sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  return all;
}

// The conflict graph over the points that have conflicts, renumbered densely in point order, and
// its connected components.
struct ConflictGraph {
  std::vector<Index> point;            // Node → point.
  std::vector<std::size_t> first;      // Node → its first neighbour; one past the end as well.
  std::vector<Index> neighbour;        // Ascending per node.
  std::vector<Index> member;           // Nodes grouped by component, ascending.
  std::vector<std::size_t> component;  // Component → its first member; one past the end too.
};

ConflictGraph BuildGraph(const std::vector<Pair>& conflicts, std::size_t points) {
  ConflictGraph g;
  std::vector<Index> node(points, kNone);
  for (const auto& [a, b] : conflicts) node[a] = node[b] = 0;
  for (Index p = 0; p < points; ++p) {
    if (node[p] == kNone) continue;
    node[p] = static_cast<Index>(g.point.size());
    g.point.push_back(p);
  }
  g.first.assign(g.point.size() + 1, 0);
  for (const auto& [a, b] : conflicts) ++g.first[node[a] + 1], ++g.first[node[b] + 1];
  for (std::size_t n = 0; n < g.point.size(); ++n) g.first[n + 1] += g.first[n];
  g.neighbour.resize(2 * conflicts.size());
  auto next = g.first;
  // Conflicts are sorted by (larger, smaller), so a node first meets its smaller neighbours in
  // ascending order, as the first of each pair, and then its larger ones, as the second.
  for (const auto& [a, b] : conflicts) g.neighbour[next[node[a]]++] = node[b];
  for (const auto& [a, b] : conflicts) g.neighbour[next[node[b]]++] = node[a];
  return g;
}

void FindComponents(ConflictGraph& g) {
  const std::size_t nodes = g.point.size();
  std::vector<std::uint8_t> seen(nodes, 0);
  for (Index root = 0; root < nodes; ++root) {
    if (seen[root]) continue;
    const std::size_t begin = g.member.size();
    g.component.push_back(begin);
    g.member.push_back(root);
    seen[root] = 1;
    for (std::size_t i = begin; i < g.member.size(); ++i) {
      const Index n = g.member[i];
      for (std::size_t e = g.first[n]; e < g.first[n + 1]; ++e) {
        if (seen[g.neighbour[e]]) continue;
        seen[g.neighbour[e]] = 1;
        g.member.push_back(g.neighbour[e]);
      }
    }
  }
  g.component.push_back(g.member.size());
}

// One component, worked off by a priority queue with lazy updates.
class Component {
 public:
  Component(const RejectionInput& input, const ConflictGraph& graph,
            std::vector<std::uint8_t>& survives)
      : input_(input), graph_(graph), survives_(survives) {}

  void Resolve(std::size_t number) {
    const std::size_t begin = graph_.component[number], end = graph_.component[number + 1];
    if (end - begin == 2) {
      const Index a = graph_.member[begin], b = graph_.member[begin + 1];
      // The two are equally far from each other's "centroid": a tie.
      const bool a_goes = GoesFirst({0, a}, {0, b});
      Bequeath(a_goes ? a : b, a_goes ? b : a);
      Remove(a_goes ? a : b);
      return;
    }
    for (std::size_t i = begin; i < end; ++i) Enqueue(graph_.member[i]);
    while (!queue_.empty()) {
      const Candidate worst = queue_.top();
      queue_.pop();
      if (!Alive(worst.node) || Score(worst.node) != worst.score) continue;
      if (!input_.area.empty()) Bequeath(worst.node, Heir(worst.node));
      Remove(worst.node);
      for (std::size_t e = graph_.first[worst.node]; e < graph_.first[worst.node + 1]; ++e) {
        if (Alive(graph_.neighbour[e])) Enqueue(graph_.neighbour[e]);
      }
    }
  }

 private:
  struct Candidate {
    double score;  // Squared distance to the neighbours' centroid; < 0 = no neighbour left.
    Index node;
  };

  bool Alive(Index node) const { return survives_[graph_.point[node]] != 0; }
  // The nearest neighbour that is left; there is one.
  Index Heir(Index node) const {
    Candidate best{0, kNone};
    for (std::size_t e = graph_.first[node]; e < graph_.first[node + 1]; ++e) {
      const Candidate other{Norm2(Position(graph_.neighbour[e]) - Position(node)),
                            graph_.neighbour[e]};
      if (!Alive(other.node)) continue;
      // Of equal distances GoesFirst tells who would go first.
      if (best.node == kNone || GoesFirst(best, other)) best = other;
    }
    return best.node;
  }
  void Bequeath(Index from, Index to) {
    if (input_.area.empty()) return;
    FixedArea& left = input_.area[graph_.point[from]];
    FixedArea& heir = input_.area[graph_.point[to]];
    heir = AddAreas(heir, std::exchange(left, 0));
  }
  void Remove(Index node) { survives_[graph_.point[node]] = kRemovedSample; }
  Vec3 Position(Index node) const { return input_.position[graph_.point[node]]; }

  // Computed afresh each time, over the neighbours in ascending order, so that the score is a
  // function of who is left and not of the order in which the others went.
  double Score(Index node) const {
    Vec3 sum;
    double count = 0;
    for (std::size_t e = graph_.first[node]; e < graph_.first[node + 1]; ++e) {
      if (!Alive(graph_.neighbour[e])) continue;
      sum = sum + Position(graph_.neighbour[e]);
      ++count;
    }
    if (count == 0) return -1;
    const Vec3 centroid{sum.x / count, sum.y / count, sum.z / count};
    return Norm2(centroid - Position(node));
  }

  bool GoesFirst(const Candidate& a, const Candidate& b) const {
    if (a.score != b.score) return a.score > b.score;
    const Index p = graph_.point[a.node], q = graph_.point[b.node];
    if (input_.time[p] != input_.time[q]) return input_.time[p] > input_.time[q];
    if (input_.cell[p] != input_.cell[q]) return input_.cell[p] > input_.cell[q];
    return p > q;
  }
  void Enqueue(Index node) {
    const double score = Score(node);
    if (score >= 0) queue_.push({score, node});
  }

  struct Order {
    const Component* component;
    bool operator()(const Candidate& a, const Candidate& b) const {
      return component->GoesFirst(b, a);
    }
  };

  const RejectionInput& input_;
  const ConflictGraph& graph_;
  std::vector<std::uint8_t>& survives_;
  std::priority_queue<Candidate, std::vector<Candidate>, Order> queue_{Order{this}};
};

// Whether the component holds an open point; then all of it is open.
bool LeaveIfOpen(const ConflictGraph& graph, std::size_t number, std::vector<std::uint8_t>& fate) {
  const auto begin = graph.member.begin() + static_cast<std::ptrdiff_t>(graph.component[number]);
  const auto end = graph.member.begin() + static_cast<std::ptrdiff_t>(graph.component[number + 1]);
  const auto is_open = [&](Index node) { return fate[graph.point[node]] == kOpenSample; };
  if (std::none_of(begin, end, is_open)) return false;
  for (auto node = begin; node != end; ++node) fate[graph.point[*node]] = kOpenSample;
  return true;
}

}  // namespace

Result<std::vector<std::uint8_t>> RejectClosePoints(const RejectionInput& input, double distance,
                                                    const RunContext& context,
                                                    std::span<const std::uint8_t> open) {
  std::vector<std::uint8_t> survives(input.position.size(), kSurvivingSample);
  for (std::size_t i = 0; i < open.size(); ++i) {
    if (open[i] != 0) survives[i] = kOpenSample;
  }
  if (!(distance > 0) || input.position.size() < 2) return survives;
  const std::vector<Pair> conflicts = FindConflicts(input.position, distance);
  if (context.cancelled()) return Cancelled();
  ConflictGraph graph = BuildGraph(conflicts, input.position.size());
  FindComponents(graph);
  const std::size_t components = graph.component.size() - 1;
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, components, 64), [&](const auto& r) {
    if (context.cancelled()) return;
    Component component(input, graph, survives);
    for (auto c = r.begin(); c != r.end(); ++c) {
      if (!LeaveIfOpen(graph, c, survives)) component.Resolve(c);
    }
  });
  if (context.cancelled()) return Cancelled();
  return survives;
}

}  // namespace strata
