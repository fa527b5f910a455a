// The door through which triangles enter: io/ implements it per file format, core/ only pulls.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/vec3.h"

namespace strata {

class RunContext;

/// Why a triangle that stands in the file was not sampled. Each is counted, none is silent.
enum class SkipReason : std::uint8_t {
  kIndexOutOfRange,  ///< A corner names a vertex that does not exist (whole polygon skipped).
  kTooFewCorners,    ///< A face with fewer than three corners.
  kNonFinite,        ///< A corner is NaN or infinite.
  kZeroArea,         ///< The corners lie on one line or coincide (in sampling also: once rounded to
                     ///< numbers counted from the lattice's origin).
};
inline constexpr int kSkipReasonCount = 4;
/// Stable names for reports, in the order of SkipReason.
inline constexpr std::array<const char*, kSkipReasonCount> kSkipReasonNames = {
    "index_out_of_range", "too_few_corners", "non_finite", "zero_area"};

using SkipCounts = std::array<std::uint64_t, kSkipReasonCount>;

/// Up to `capacity` triangles as nine coordinate columns, ready for vector code.
///
/// Column `3*v + a` holds axis `a` of corner `v`, in world units as read from the file (float
/// values widened, never rounded). Columns are 64-byte aligned and padded so that vector code may
/// load past `size` up to the next multiple of 16; what it finds there is unspecified but readable.
class TriangleBatch {
 public:
  explicit TriangleBatch(std::size_t capacity);

  std::size_t capacity() const { return capacity_; }
  std::size_t size() const { return size_; }
  bool full() const { return size_ == capacity_; }
  void Clear() { size_ = 0; }

  const double* column(int k) const { return columns_ + static_cast<std::size_t>(k) * stride_; }
  double* column(int k) { return columns_ + static_cast<std::size_t>(k) * stride_; }
  /// The triangle's position in file order, starting at 0; skipped triangles use up a number too.
  const std::uint64_t* ids() const { return ids_.data(); }
  std::uint64_t* ids() { return ids_.data(); }

  Vec3 corner(std::size_t i, int v) const {
    return {column(3 * v)[i], column(3 * v + 1)[i], column(3 * v + 2)[i]};
  }
  /// Appends one triangle. Precondition: !full().
  void Push(Vec3 a, Vec3 b, Vec3 c, std::uint64_t id) {
    double* p = columns_ + size_;
    p[0] = a.x, p[stride_] = a.y, p[2 * stride_] = a.z;
    p[3 * stride_] = b.x, p[4 * stride_] = b.y, p[5 * stride_] = b.z;
    p[6 * stride_] = c.x, p[7 * stride_] = c.y, p[8 * stride_] = c.z;
    ids_[size_++] = id;
  }
  /// For readers that fill the columns directly. Precondition: n <= capacity().
  void set_size(std::size_t n) { size_ = n; }

 private:
  struct Free {
    void operator()(double* p) const;
  };
  std::size_t capacity_, stride_, size_ = 0;
  std::unique_ptr<double[], Free> storage_;
  double* columns_;
  std::vector<std::uint64_t> ids_;
};

/// A mesh's vertices, as the file's own precision. At most one of the two spans is non-empty; each
/// holds x0,y0,z0,x1,…
struct VertexView {
  std::span<const float> f32;
  std::span<const double> f64;

  std::size_t size() const { return (f32.size() + f64.size()) / 3; }
  Vec3 operator[](std::size_t i) const {
    if (!f32.empty()) return {f32[3 * i], f32[3 * i + 1], f32[3 * i + 2]};
    return {f64[3 * i], f64[3 * i + 1], f64[3 * i + 2]};
  }
};

/// What a file holds beside its triangles, as far as its format has such things. Names may be
/// empty, and are the file's: any bytes.
struct MeshContents {
  std::optional<std::uint64_t> meshes;     ///< Meshes that the file defines.
  std::optional<std::uint64_t> instances;  ///< How often meshes are placed, in all.
  std::vector<std::string> materials;      ///< Their names, in file order.
  std::vector<std::string> textures;       ///< Where each image is: a path, or "embedded".
  std::string unit;     ///< "metre", "millimetre", …; "" if the file is silent.
  std::string up_axis;  ///< "y", "z"; "" if neither file nor format says.
  /// What is there and is no surface, by name, with how many: "points primitives".
  std::vector<std::pair<std::string, std::uint64_t>> passed_over;
};

/// An image that materials take their base colour from, as far as it can be seen without decoding.
struct MeshTexture {
  std::string place;  ///< As the file has it: a path, or "embedded".
  std::string type;   ///< "png", "jpeg", "webp"; "" if it cannot be read.
  std::uint64_t bytes = 0;
  std::uint32_t width = 0, height = 0;     ///< Pixels.
  int channels = 0, bits = 0;              ///< Of the file's pixels.
  std::vector<std::uint32_t> materials{};  ///< That use it: numbers in MeshContents::materials.
  std::string fault;                       ///< Why it cannot be read; "" if it can.
};

/// What a mesh file says of itself.
struct MeshInfo {
  std::string format;       ///< "ply", "obj", "stl", "off", "gltf", "glb", "drc", "3mf", …
  std::string encoding;     ///< "ascii", "binary_little_endian", "binary_big_endian", …
  std::string compression;  ///< "none", "gzip", "zstd"
  MeshContents contents{};
};

/// What was read so far; final once Read has returned 0.
struct ReadCounts {
  std::uint64_t vertices = 0;   ///< Vertices in the file (STL: three per triangle).
  std::uint64_t faces = 0;      ///< Polygons, strips' triangles or facets in the file.
  std::uint64_t triangles = 0;  ///< Triangles after triangulation, skipped ones included.
  SkipCounts skipped{};         ///< Only kIndexOutOfRange and kTooFewCorners are counted here.

  void Add(const ReadCounts& other) { Combine(other, std::plus<>()); }
  /// What was read before some of it. Precondition: nothing of `some` is more.
  void Subtract(const ReadCounts& some) { Combine(some, std::minus<>()); }

 private:
  template <class Operation>
  void Combine(const ReadCounts& other, Operation operation) {
    vertices = operation(vertices, other.vertices);
    faces = operation(faces, other.faces);
    triangles = operation(triangles, other.triangles);
    for (std::size_t r = 0; r < skipped.size(); ++r) {
      skipped[r] = operation(skipped[r], other.skipped[r]);
    }
  }
};

/// One of `count` shares of a mesh's triangles: blocks of kBlock by their number in file order,
/// dealt out in turn; of these the triangles from number `first` on. Precondition: index < count.
struct Share {
  static constexpr int kBlockBits = 16;
  static constexpr std::uint64_t kBlock = std::uint64_t{1} << kBlockBits;

  std::uint32_t index = 0, count = 1;
  std::uint64_t first = 0;
  bool whole() const { return count == 1 && first == 0; }
  bool Holds(std::uint64_t triangle) const {
    return triangle >= first && (count == 1 || (triangle >> kBlockBits) % count == index);
  }
  /// The share's first triangle from number `triangle` on; UINT64_MAX where there is none.
  std::uint64_t Next(std::uint64_t triangle) const {
    triangle = std::max(triangle, first);
    if (count == 1) return triangle;
    const std::uint64_t block = triangle >> kBlockBits;
    const std::uint64_t wait = (index + std::uint64_t{count} - block % count) % count;
    if (wait == 0) return triangle;
    return wait > (UINT64_MAX >> kBlockBits) - block ? UINT64_MAX : (block + wait) << kBlockBits;
  }
  /// One past the last of the consecutive triangles that follow `triangle`, which the share holds.
  std::uint64_t RunEnd(std::uint64_t triangle) const {
    const std::uint64_t block = triangle >> kBlockBits;
    if (count == 1 || block == UINT64_MAX >> kBlockBits) return UINT64_MAX;
    return (block + 1) << kBlockBits;
  }
};

/// How far MeshReader::CheckAttribute looks: heads of files tell that they are there and how large
/// they are, and only reading them whole that nothing of them is damaged.
enum class CheckDepth : std::uint8_t { kHeads, kWhole };

/// Pulls triangles, in file order, from a mesh whose triangles need not fit in memory.
///
/// Opening (io/open_mesh.h) has already read the vertices of an indexed format, so every index can
/// be resolved. Memory: the vertex array, or the budget it was given if it exceeds that, and fixed
/// buffers, whatever the number of triangles; no
/// allocation is sized by a count the file claims before that many bytes were seen.
/// Threads: one at a time. Destroying the reader closes the file.
class MeshReader {
 public:
  virtual ~MeshReader() = default;

  virtual const MeshInfo& info() const = 0;
  /// All vertices of the file, referenced or not; empty for formats without a vertex list (STL) and
  /// where the vertices exceed their budget. Valid as long as the reader.
  virtual VertexView vertices() const = 0;
  /// Calls `visit` with all vertices, in file order, as many at a time as are at hand; false, and
  /// no call, for formats without a vertex list. Works at any time between reads and does not move
  /// the reader. Errors: kIo, kCancelled.
  virtual Result<bool> VisitVertices(const std::function<void(const VertexView&)>& visit) {
    if (vertices().size() == 0) return false;
    visit(vertices());
    return true;
  }
  /// From now on, Rewind included, Read gives only the triangles that `share` holds, with the
  /// numbers they have in the whole mesh, and reads few bytes of the file beyond theirs. counts()
  /// is then the share's own: over all shares faces, triangles and skips add up to those of the
  /// whole mesh, and so do vertices, as those of a vertex list, which every share reads whole, are
  /// counted by share 0 alone. Share{} gives the whole mesh again.
  ///
  /// False if the file does not tell without being read where the triangles of a share lie: Read
  /// gives all of them, counts() counts all, and the caller must filter. The answer depends on
  /// the file and on whether the share is the whole, so that all shares of a mesh agree on it. What
  /// a share alone cannot see wrong is seen by another: only when all shares have been read without
  /// an error are they the mesh. Precondition: nothing was read since opening or the last Rewind,
  /// or Rewind comes next.
  virtual bool SelectShare(const Share& share) { return share.whole(); }
  /// Clears `batch`, fills it with the next triangles, and returns how many; 0 means the end.
  /// Corners may be non-finite or coincide: judging that is the caller's.
  /// Errors: kCorruptInput (file, byte offset or line, found, expected), kIo. After an error the
  /// reader is spent.
  virtual Result<std::size_t> Read(TriangleBatch& batch) = 0;
  /// Goes back to the first triangle and resets counts().faces, triangles and skipped.
  virtual Result<void> Rewind() = 0;
  virtual const ReadCounts& counts() const = 0;

  /// What the mesh carries besides its shape, known from opening on; empty for a format or a reader
  /// that has nothing more to give. Names are as FixNames leaves them. Valid as long as the reader.
  virtual std::span<const MeshAttribute> attributes() const { return {}; }
  /// Begins to fetch the attributes with these numbers in attributes(), in a pass of its own over
  /// the file: Read must not be called before the next Rewind, and the pass must not be used after
  /// it or after the reader. Any share gives the attributes of the whole mesh.
  ///
  /// Memory: of the context's account, a part of what is left; what does not fit goes to its
  /// scratch space or is read again. Errors: as Read's; kOverBudget, kCancelled.
  virtual Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t>,
                                                                RunContext&) {
    return Fail(ErrorCode::kInternal, info().format + ": this reader carries no attributes");
  }
  /// Whether what an attribute needs from outside the mesh's own data, such as images, is there and
  /// fits the account. Errors: kNotFound, kUnsupported (not here, or not in a form that is read);
  /// kCorruptInput, kOverBudget, kIo; kCancelled.
  virtual Result<void> CheckAttribute(std::size_t, CheckDepth, RunContext&) { return {}; }
  /// The images that materials name. Opens them; what is wrong with one is part of the answer.
  virtual std::vector<MeshTexture> InspectTextures(RunContext&) { return {}; }

  /// Bytes consumed of the input as stored (compressed size for .gz), and its size if known: for
  /// progress. With a share selected, bytes passed over count as consumed.
  virtual std::uint64_t bytes_read() const = 0;
  virtual std::optional<std::uint64_t> bytes_total() const = 0;
};

}  // namespace strata
