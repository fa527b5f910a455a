// The samples of a job, and the door through which they leave: io/ implements SampleWriter per
// file format.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/cell_octree.h"
#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata {

/// What can stand beside a sample's position. Values are bits of an AttributeSet.
enum Attribute : std::uint32_t {
  kNormal = 1,    ///< Unit face normal, counter-clockwise corners seen from outside; 3 × float32.
  kTriangle = 2,  ///< Position of its triangle in file order, from 0; uint64.
  kBarycentric = 4,  ///< Weights of the triangle's corners in file order, sum 1; 3 × float64.
  kCell = 8,         ///< The lattice cell that drew the sample; 3 × int32.
  /// Surface that the sample stands for, world units squared; float64. That inside its cell, and
  /// inside the cells whose samples the minimum distance removed in its favour: over all samples
  /// the areas add up to the mesh's (docs/adr/0022).
  kArea = 16,
  kWeight = 32,  ///< The density f = exp(-lambda d) at the sample, 0 < f <= 1; float64.
};
using AttributeSet = std::uint32_t;
inline constexpr AttributeSet kAllAttributes = 63;

/// Names on the command line, on the wire and in files, in the order of the bits.
inline constexpr std::array<const char*, 6> kAttributeNames = {"normal", "triangle", "barycentric",
                                                               "cell",   "area",     "weight"};

/// Samples as columns of equal length. A column that was not asked for is empty.
struct SampleColumns {
  std::vector<Vec3> position;  ///< World units. Always present.
  std::vector<Vec3f> normal;
  std::vector<std::uint64_t> triangle;
  std::vector<std::array<double, 3>> barycentric;
  std::vector<Cell> cell;
  std::vector<double> area;
  std::vector<double> weight;
  /// Columns that the mesh's attributes became: bytes of all values one after the other, each of
  /// MeshAttribute::bytes(). What each is, the header or result that comes with the samples says.
  std::vector<std::vector<char>> carried;

  std::size_t size() const { return position.size(); }
  /// Adds samples with the same columns at the end.
  void Append(SampleColumns&& more);
};

/// Samples on their way out, in canonical order: by block of 8^3 cells, then by cell. Threads: one.
class SampleSource {
 public:
  virtual ~SampleSource() = default;
  /// Replaces `out` by the next samples, any number above 0; false at the end. Errors: kIo,
  /// kCorruptInput (a damaged run).
  virtual Result<bool> Next(SampleColumns& out) = 0;
};

/// What a writer must know before the first sample.
struct SampleHeader {
  std::uint64_t count = 0;  ///< Samples that will be written.
  AttributeSet attributes = kNormal;
  std::vector<MeshAttribute> carried;  ///< What SampleColumns::carried holds, in the same order.
  double edge = 1;                     ///< The cell's edge `e`, world units.
  Vec3 lattice_origin;                 ///< A corner of the cell (0,0,0); world units.
  Bounds bounds;                       ///< Encloses every position; world units.
  /// Encloses every position, too, and is known before any sample is: the surface's. Tiles' lattice
  /// of positions is a function of it. Empty = as `bounds`.
  Bounds surface;
  /// No tile crosses their borders (core/parcels.h); ascending. Empty = one for everything.
  std::vector<OctreeNode> parcels;
  double position_error = 0;  ///< Largest distance a lossy format may move a sample, world units.
  std::string provenance;     ///< One line of JSON: version, surface hash, options, seed.
};

/// Takes the samples of one job, in the order in which they shall stand in the file.
///
/// Call Write any number of times, then Finish once. The output appears under its name only in
/// Finish; a writer destroyed before leaves nothing. Threads: one at a time.
class SampleWriter {
 public:
  virtual ~SampleWriter() = default;
  /// Columns must match the header's attributes. Errors: kIo, kOverBudget.
  virtual Result<void> Write(const SampleColumns& columns) = 0;
  /// Errors: kIo; kInternal when the number of samples differs from the header's count.
  /// Returns the number of bytes of the output.
  virtual Result<std::uint64_t> Finish() = 0;
};

}  // namespace strata
