// The rows of a PLY file's elements, in one encoding: what ascii and binary have in common.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/face_assembler.h"
#include "io/ply_header.h"
#include "io/vertex_store.h"

namespace strata::io {

/// A place between two rows.
struct PlyMark {
  std::uint64_t offset = 0, line = 1;
};

/// A place within a surface.
struct PlyProgress {
  PlyMark mark;
  std::uint64_t rows_left = 0;
  bool in_strip_list = false;
  std::uint64_t strip_left = 0;  ///< Items left of the list being read.
  std::uint64_t run_left = 0;    ///< Rows left of the share's run being read.
};

/// What the properties of `face` or `tristrips` mean to us.
struct PlySurface {
  const PlyElement* element = nullptr;
  std::size_t indices = 0;  ///< Which property is the list of corners.
  bool strips = false;      ///< The lists are triangle strips, -1 begins the next strip.
};

/// Decodes rows in file order. Errors: kCorruptInput with offset or line, kIo; after one the object
/// is spent. Threads: one at a time.
class PlyRows {
 public:
  virtual ~PlyRows() = default;

  virtual PlyMark mark() const = 0;
  virtual Result<void> Seek(const PlyMark& mark) = 0;
  /// Passes over all rows of `element`, which begin here.
  virtual Result<void> Skip(const PlyElement& element) = 0;
  /// Appends x, y, z (the properties numbered in `xyz`) of all rows of `element` to `vertices`.
  /// Throws std::bad_alloc.
  virtual Result<void> ReadVertices(const PlyElement& element, const std::size_t (&xyz)[3],
                                    VertexStore& vertices) = 0;
  /// The bytes of all rows of `element` if every list among them has `list_length` items, or none
  /// if that is no number, or it takes more than rows of one size to tell (ascii).
  virtual std::optional<std::uint64_t> BytesOf(const PlyElement& element,
                                               std::uint64_t list_length) const = 0;
  /// From the next BeginSurface on, reads only the faces that `share` holds, whose lists must have
  /// three items: then every row is one triangle, and of one size. Another length is kUnsupported.
  /// Share{} reads everything. Precondition, unless it is that: BytesOf tells the surface's size.
  virtual void SelectShare(const Share& share) = 0;
  /// The rows of `surface` begin here.
  virtual void BeginSurface(const PlySurface& surface) = 0;
  /// Adds faces until the assembler is full or the surface's rows are used up; true if the latter.
  /// Throws std::bad_alloc.
  virtual Result<bool> ReadSurface(FaceAssembler& faces) = 0;
  /// Where reading stands, within a surface or between elements; and to go back to there, after
  /// BeginSurface if it was within one.
  virtual PlyProgress progress() const = 0;
  virtual Result<void> Resume(const PlyProgress& progress) = 0;
  /// After the last row: what follows may only be padding.
  virtual Result<void> CheckEnd() = 0;
};

/// A face with more corners than this is refused as kUnsupported: a polygon must be held in memory.
inline constexpr std::uint64_t kMaxPlyCorners = std::uint64_t{1} << 20;

/// Between strips stands -1, in unsigned types what a 32-bit -1 looks like.
inline bool IsStripEnd(std::int64_t index, PlyType type) {
  return index == -1 || (type == PlyType::kUint32 && index == 0xffffffff);
}

/// `input` stands at the header's data_offset and outlives the rows.
std::unique_ptr<PlyRows> BinaryPlyRows(InputBuffer& input, const PlyHeader& header);
std::unique_ptr<PlyRows> AsciiPlyRows(InputBuffer& input, const PlyHeader& header);

}  // namespace strata::io
