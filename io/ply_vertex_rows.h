// Vertex rows of fixed size in a binary PLY file.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>

#include "io/byte_source.h"
#include "io/ply_value.h"
#include "io/vertex_file.h"

namespace strata::io {

/// Where x, y and z stand in a row, and as what.
struct PlyVertexRows {
  struct Axis {
    std::size_t offset = 0;
    PlyType type = PlyType::kFloat32;
  };

  std::array<Axis, 3> axes;
  std::size_t stride = 0;  ///< Bytes of a row.
  bool swap = false;       ///< The file is big-endian.

  bool all_float32() const {
    return std::all_of(axes.begin(), axes.end(),
                       [](const Axis& a) { return a.type == PlyType::kFloat32; });
  }
  /// True if some type holds numbers that no float does.
  bool is_double() const {
    return std::any_of(axes.begin(), axes.end(), [](const Axis& a) {
      return a.type == PlyType::kFloat64 || a.type == PlyType::kInt32 || a.type == PlyType::kUint32;
    });
  }
  /// True if a row is nothing but three floats as this machine has them.
  bool bare() const {
    return all_float32() && !swap && stride == 12 && axes[0].offset == 0 && axes[1].offset == 4;
  }
};

/// Three floats for each of `n` rows. Precondition: rows.all_float32().
template <bool kSwap>
void CopyPlyFloats(const PlyVertexRows& rows, const char* from, std::size_t n, float* to) {
  if (!kSwap && rows.bare()) {
    std::memcpy(to, from, n * rows.stride);
    return;
  }
  for (; n > 0; --n, from += rows.stride, to += 3) {
    for (std::size_t a = 0; a < 3; ++a) {
      to[a] = std::bit_cast<float>(LoadBits<std::uint32_t, kSwap>(from + rows.axes[a].offset));
    }
  }
}

/// `count` such rows from byte `offset` of `source` on, read where they stand: no copy is made.
/// Preconditions: they exist, source.can_read_at(); `source` must outlive the file. Doubles if
/// rows.is_double(). Memory: 32 KiB.
std::unique_ptr<VertexFile> OpenPlyVertexFile(ByteSource& source, const PlyVertexRows& rows,
                                              std::uint64_t offset, std::uint64_t count);

}  // namespace strata::io
