#include "core/summarize_mesh.h"

#include <cmath>

#include "core/triangle_hash.h"

namespace strata {
namespace {

constexpr std::size_t kBatch = 2048;

// Below this, relative to the edges, a cross product may be nothing but rounding: then the
// canonical rotation decides whether there is an area, as it does for sampling.
constexpr double kDoubtful = 1e-24;

class Summarizer {
 public:
  explicit Summarizer(MeshSummary& summary) : summary_(summary) {}

  void Add(const TriangleBatch& batch) {
    double area = 0;
    for (std::size_t i = 0; i < batch.size(); ++i) {
      const Vec3 a = batch.corner(i, 0), b = batch.corner(i, 1), c = batch.corner(i, 2);
      const Vec3 ab = b - a, ac = c - a;
      const double n2 = Norm2(Cross(ab, ac));
      if (!(n2 > kDoubtful * Norm2(ab) * Norm2(ac)) || !(n2 < HUGE_VAL)) {
        if (!AcceptDoubtful(a, b, c)) continue;
      }
      area += std::sqrt(n2);
      ++summary_.surface_triangles;
      summary_.bounds.Add(a);
      summary_.bounds.Add(b);
      summary_.bounds.Add(c);
    }
    summary_.area += 0.5 * area;
  }

 private:
  bool AcceptDoubtful(Vec3 a, Vec3 b, Vec3 c) {
    const Vec3 n = CanonicalAreaVector(a, b, c);
    if (IsUsable(n)) return true;
    const bool zero = Norm2(n) == 0;
    ++summary_
          .skipped[static_cast<std::size_t>(zero ? SkipReason::kZeroArea : SkipReason::kNonFinite)];
    return false;
  }

  MeshSummary& summary_;
};

void AddBounds(const VertexView& vertices, Bounds& bounds) {
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    const Vec3 p = vertices[i];
    if (std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z)) bounds.Add(p);
  }
}

}  // namespace

Result<MeshSummary> SummarizeMesh(MeshReader& reader, RunContext& context) {
  MeshSummary summary;
  Summarizer summarizer(summary);
  TriangleBatch batch(kBatch);
  context.SetStage(RunContext::Stage::kScan);
  for (;;) {
    if (context.cancelled()) return Cancelled();
    const auto count = reader.Read(batch);
    if (!count) return Forward(count);
    if (*count == 0) break;
    summarizer.Add(batch);
    context.AddTriangles(*count);
    context.SetProgress(reader.bytes_read(), reader.bytes_total().value_or(0));
  }
  summary.read = reader.counts();
  for (std::size_t r = 0; r < summary.skipped.size(); ++r) {
    summary.skipped[r] += summary.read.skipped[r];
  }
  auto visited =
      reader.VisitVertices([&](const VertexView& some) { AddBounds(some, summary.vertex_bounds); });
  if (!visited) return Forward(visited);
  return summary;
}

}  // namespace strata
