// Meshes that a file defines once and places several times, as one stream of triangles.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/affine.h"
#include "io/byte_source.h"
#include "io/face_assembler.h"
#include "io/vertex_store.h"

namespace strata::io {

/// Triangles over a vertex list. Threads: one at a time.
class PlacedGeometry {
 public:
  virtual ~PlacedGeometry() = default;
  virtual const VertexStore& vertices() const = 0;
  /// The corners of triangle `number`; fewer than three for a rest that makes none. Valid until the
  /// next call. Errors: kIo.
  virtual Result<std::span<const std::int64_t>> Corners(std::uint64_t number) = 0;
};

/// A geometry and where it is placed: a run of the reader's transforms.
struct Placement {
  std::size_t first_transform = 0, count = 0;
  std::uint64_t triangles = 0;  ///< Of one placing; > 0.
};

/// Gives the triangles by placement, then by transform. Only the present geometry is loaded; where
/// its vertices are in memory its placings cost nothing more. No vertex list: it has none in world
/// space. Threads: one at a time.
class PlacedReader : public MeshReader {
 public:
  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return {}; }
  const ReadCounts& counts() const override { return counts_; }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }
  /// Data are read here and there: as much of the file as of the triangles.
  std::uint64_t bytes_read() const override;
  bool SelectShare(const Share& share) override;
  Result<std::size_t> Read(TriangleBatch& batch) override;
  Result<void> Rewind() override;

 protected:
  explicit PlacedReader(std::unique_ptr<ByteSource> source) : source_(std::move(source)) {}

  /// Loads the geometry of a placement; the one before is gone.
  virtual Result<std::shared_ptr<PlacedGeometry>> LoadGeometry(std::size_t placement) = 0;
  virtual const Affine& TransformOf(std::size_t number) const = 0;
  /// While opening, in order. kOverBudget beyond 2^64 triangles.
  Result<void> AddPlacement(const Placement& placement);
  ByteSource& source() const { return *source_; }

  /// Where a triangle of this number stands. Precondition: it exists.
  struct Location {
    std::size_t placement = 0, transform = 0;
    std::uint64_t triangle = 0;  ///< Within the geometry.
  };
  Location Locate(std::uint64_t triangle) const;
  /// Gives back the memory of the present geometry; Rewind comes next.
  void DropGeometry();

  MeshInfo info_;
  std::uint64_t vertex_count_ = 0;  ///< Of all vertex lists: what counts() says.

 private:
  struct Numbered {
    Placement placement;
    std::uint64_t begin = 0, end = 0;  // Of its triangles' numbers.
  };

  Result<bool> Enter();
  void StartFaces();
  void UpdateCounts();
  Result<void> ReadSome(TriangleBatch& batch);
  Result<void> Fill(FaceAssembler& faces);
  Result<void> LookAhead(FarVertices& far);
  void Place(TriangleBatch& batch, std::size_t begin) const;

  std::unique_ptr<ByteSource> source_;
  std::vector<Numbered> placements_;
  std::uint64_t triangle_count_ = 0;
  Share share_;
  std::uint64_t next_ = 0;
  std::size_t at_ = 0, loaded_ = 0;  // The placement of next_; that of geometry_.
  std::shared_ptr<PlacedGeometry> geometry_;
  FaceAssembler faces_;
  ReadCounts done_, counts_;
};

}  // namespace strata::io
