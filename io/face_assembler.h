// From corner indices to triangles in a batch, with ids and counts.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh_reader.h"
#include "io/far_vertices.h"
#include "io/vertex_store.h"

namespace strata::io {

/// Resolves the faces and strips of an indexed mesh and cuts polygons into triangles.
///
/// A polygon that does not fit the batch keeps its remaining triangles for the next one. Memory:
/// proportional to the largest polygon. Threads: one at a time.
class FaceAssembler {
 public:
  /// `vertices` must outlive the assembler's use.
  void SetVertices(const VertexStore& vertices) {
    vertices_ = vertices.view();
    far_ = vertices.far();
    counts_.vertices = vertex_count_ = vertices.size();
  }
  /// How many vertices there are, whoever counts them.
  std::uint64_t vertex_count() const { return vertex_count_; }
  /// Whether counts() has the vertices, or the assembler of another share.
  void CountVertices(bool counted) { counts_.vertices = counted ? vertex_count_ : 0; }
  const VertexView& vertices() const { return vertices_; }
  /// Vertices on disk, or null: then vertices() has them all.
  FarVertices* far() const { return far_; }
  const ReadCounts& counts() const { return counts_; }

  /// An assembler that goes on from here but only records the indices that this one will ask far()
  /// for; it has no batch, and ids and counts of its own.
  FaceAssembler Scout() const;
  bool scouting() const { return scouting_; }

  /// Back to the first face: ids, counts and whatever is unfinished.
  void Restart();

  /// Clears `batch`, puts triangles left over from the batch before into it, and goes on with it.
  void Begin(TriangleBatch& batch);
  /// Goes on into `batch` behind what stands there. For meshes of triangles alone: nothing is ever
  /// left over.
  void Continue(TriangleBatch& batch) { batch_ = &batch; }
  TriangleBatch& batch() { return *batch_; }
  /// The batch is full, or ends here for far()'s sake.
  bool full() const {
    return far_ == nullptr ? batch_->full() : far_->AtBorder() || (!scouting_ && batch_->full());
  }

  /// Adds a face. Fewer than three corners or an index out of range skip the whole face under its
  /// reason; it uses up the numbers of its triangles, and one at least. Precondition: !full().
  void AddFace(std::span<const std::int64_t> corners);

  /// Adds the next corner of a triangle strip; winding alternates. A corner out of range skips the
  /// triangles it belongs to. Precondition: !full().
  void AddStripCorner(std::int64_t index);
  /// Ends a strip. One of one or two corners counts as a face with too few.
  void EndStrip();

  /// For readers that fill the batch's columns themselves: the next triangle's id, and the note
  /// that `n` triangles, numbered from there, have been appended.
  std::uint64_t next_id() const { return passed_ + counts_.triangles; }
  /// Uses up the numbers of `n` triangles of another share, which are not counted.
  void PassOver(std::uint64_t n) { passed_ += n; }
  /// At most so many may be added before full() is asked again; may be 0 where a face would do.
  std::uint64_t Room() const {
    const std::uint64_t room = scouting_ ? UINT64_MAX : batch_->capacity() - batch_->size();
    return far_ == nullptr ? room : std::min(room, far_->Room());
  }
  void NoteTriangles(std::size_t n) {
    if (!scouting_) batch_->set_size(batch_->size() + n);
    counts_.faces += n;
    counts_.triangles += n;
  }

 private:
  bool InRange(std::int64_t index) const {
    return static_cast<std::uint64_t>(index) < vertex_count_;
  }
  void Skip(SkipReason reason, std::uint64_t numbers);
  void AddPolygon(std::span<const std::int64_t> corners);
  void AddTriangle(std::int64_t a, std::int64_t b, std::int64_t c);
  // In the order of asking, as Scout's records are in it.
  Vec3 At(std::int64_t index) {
    const auto i = static_cast<std::uint64_t>(index);
    return far_ == nullptr ? vertices_[static_cast<std::size_t>(i)] : far_->At(i);
  }
  void Drain();

  VertexView vertices_;
  FarVertices* far_ = nullptr;
  bool scouting_ = false;
  std::uint64_t vertex_count_ = 0, passed_ = 0;
  ReadCounts counts_;
  TriangleBatch* batch_ = nullptr;

  // A polygon that is being handed out.
  std::vector<Vec3> corners_;
  std::vector<std::array<std::uint32_t, 3>> pieces_;
  std::size_t next_piece_ = 0;

  // The last two corners of the current strip, and how many it had so far.
  std::int64_t strip_[2] = {0, 0};
  std::uint64_t strip_length_ = 0;
};

/// What MeshReader::Read does: fills `batch` through `faces`. `fill(faces)`, a Result<void>, adds
/// faces until faces.full() or the mesh's end; `look_ahead(far)` is FarVertices::LookAhead with the
/// reader's two functions. A batch ends early nowhere but at the mesh's end, so that what is summed
/// up by batches does not depend on where the vertices are.
template <class Fill, class LookAhead>
Result<std::size_t> ReadBatch(FaceAssembler& faces, TriangleBatch& batch, Fill&& fill,
                              LookAhead&& look_ahead) {
  FarVertices* const far = faces.far();
  faces.Begin(batch);
  for (;;) {
    if (far != nullptr && far->WantsLookAhead(faces.counts().triangles)) {
      if (auto ok = look_ahead(*far); !ok) return Forward(ok);
    }
    const Result<void> filled = fill(faces);
    if (far != nullptr && far->failed()) return far->failure();
    if (!filled) return Forward(filled);
    if (far == nullptr || batch.full() || !far->AtBorder()) return batch.size();
  }
}

}  // namespace strata::io
