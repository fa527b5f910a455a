#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "io/byte_cursor.h"
#include "io/ply_rows.h"
#include "io/ply_value.h"
#include "io/ply_vertex_rows.h"

namespace strata::io {
namespace {

// A row as alternating runs: so many bytes of plain values, then perhaps a list.
struct Run {
  std::size_t fixed_bytes = 0;
  bool has_list = false;
  bool wanted = false;
  PlyType count_type = PlyType::kUint8, item_type = PlyType::kInt32;
};

// `wanted` is the number of the list to be read, or one past the properties for none.
std::vector<Run> PlanRuns(const PlyElement& element, std::size_t wanted) {
  std::vector<Run> runs(1);
  for (std::size_t i = 0; i < element.properties.size(); ++i) {
    const PlyProperty& p = element.properties[i];
    Run& run = runs.back();
    if (!p.is_list) {
      run.fixed_bytes += PlySize(p.type);
      continue;
    }
    run.has_list = true;
    run.wanted = i == wanted;
    run.count_type = p.count_type;
    run.item_type = p.type;
    runs.emplace_back();
  }
  return runs;
}

// Rows of the usual shape: values of fixed size around a list of three 32-bit indices.
struct TriangleShape {
  bool usual = false;
  std::size_t before = 0, stride = 0;
};

constexpr std::size_t kTriangleBytes = 1 + 3 * sizeof(std::uint32_t);

TriangleShape ShapeOf(const std::vector<Run>& runs) {
  if (runs.size() != 2 || !runs[0].wanted || PlySize(runs[0].count_type) != 1 ||
      PlySize(runs[0].item_type) != 4) {
    return {};
  }
  const std::size_t stride = runs[0].fixed_bytes + kTriangleBytes + runs[1].fixed_bytes;
  return {stride <= ByteCursor::kMost, runs[0].fixed_bytes, stride};
}

// Writes triangles into the columns of `batch` from its size on, for as long as the rows hold lists
// of three indices in range, at most `n`. Returns how many. `rows` points at the first list.
template <bool kSwap, class Scalar>
std::size_t GatherTriangles(const char* rows, std::size_t stride, std::size_t n,
                            std::span<const Scalar> vertices, std::uint64_t first_id,
                            TriangleBatch& batch) {
  const std::size_t column = static_cast<std::size_t>(batch.column(1) - batch.column(0));
  double* to = batch.column(0) + batch.size();
  std::uint64_t* ids = batch.ids() + batch.size();
  const std::uint64_t vertex_count = vertices.size() / 3;
  for (std::size_t i = 0; i < n; ++i, rows += stride) {
    const std::uint64_t a = LoadBits<std::uint32_t, kSwap>(rows + 1);
    const std::uint64_t b = LoadBits<std::uint32_t, kSwap>(rows + 5);
    const std::uint64_t c = LoadBits<std::uint32_t, kSwap>(rows + 9);
    if (*rows != 3 || std::max({a, b, c}) >= vertex_count) return i;
    const Scalar* const corners[3] = {&vertices[3 * a], &vertices[3 * b], &vertices[3 * c]};
    for (std::size_t k = 0; k < 9; ++k) to[k * column + i] = corners[k / 3][k % 3];
    ids[i] = first_id + i;
  }
  return n;
}

// Rows of the usual shape, from the first list on.
struct RowsOfTriangles {
  const char* lists;
  std::size_t stride, n;
  std::uint64_t vertex_count;
};

// Calls visit(row number, a, b, c) for as long as the rows hold lists of three indices in range,
// and returns how many did.
template <bool kSwap, class Visit>
std::size_t ForEachTriangle(const RowsOfTriangles& in, Visit&& visit) {
  const char* list = in.lists;
  for (std::size_t i = 0; i < in.n; ++i, list += in.stride) {
    const std::uint64_t a = LoadBits<std::uint32_t, kSwap>(list + 1);
    const std::uint64_t b = LoadBits<std::uint32_t, kSwap>(list + 5);
    const std::uint64_t c = LoadBits<std::uint32_t, kSwap>(list + 9);
    if (*list != 3 || std::max({a, b, c}) >= in.vertex_count) return i;
    visit(i, a, b, c);
  }
  return in.n;
}

// GatherTriangles for vertices on disk: `fetch` looks them up.
template <bool kSwap, class Fetch>
std::size_t FetchTriangles(const RowsOfTriangles& in, Fetch&& fetch, std::uint64_t first_id,
                           TriangleBatch& batch) {
  const std::size_t column = static_cast<std::size_t>(batch.column(1) - batch.column(0));
  double* const to = batch.column(0) + batch.size();
  std::uint64_t* const ids = batch.ids() + batch.size();
  return ForEachTriangle<kSwap>(in, [&](std::size_t i, auto... corners) {
    double* p = to + i;
    const auto put = [&](std::uint64_t corner) {
      const Vec3 v = fetch(corner);
      p[0] = v.x, p[column] = v.y, p[2 * column] = v.z;
      p += 3 * column;
    };
    (put(corners), ...);
    ids[i] = first_id + i;
  });
}

template <bool kSwap>
std::size_t RecordTriangles(const RowsOfTriangles& in, FarVertices& far) {
  return ForEachTriangle<kSwap>(in,
                                [&](std::size_t, auto... corners) { (far.Record(corners), ...); });
}

template <bool kSwap>
class BinaryRows : public PlyRows {
 public:
  explicit BinaryRows(InputBuffer& input) : source_(input.source()), cursor_(input) {}

  PlyMark mark() const override { return {cursor_.offset(), 1}; }
  Result<void> Seek(const PlyMark& mark) override { return cursor_.Seek(mark.offset); }
  Result<void> CheckEnd() override { return cursor_.ExpectPaddingOnly(); }

  Result<void> Skip(const PlyElement& element) override {
    const std::vector<Run> runs = PlanRuns(element, element.properties.size());
    if (runs.size() == 1) {
      std::uint64_t bytes;
      if (__builtin_mul_overflow(element.count, std::uint64_t{runs[0].fixed_bytes}, &bytes)) {
        cursor_.Reject("expected more '" + element.name + "' than any file can hold");
        return cursor_.failure();
      }
      return bytes == 0 || cursor_.Skip(bytes) ? Result<void>() : cursor_.failure();
    }
    for (std::uint64_t i = 0; i < element.count; ++i) {
      if (!SkipRow(runs)) return cursor_.failure();
    }
    return {};
  }

  Result<void> ReadVertices(const PlyElement& element, const std::size_t (&xyz)[3],
                            VertexStore& vertices) override {
    const std::vector<Run> runs = PlanRuns(element, element.properties.size());
    const bool fixed = runs.size() == 1 && runs[0].fixed_bytes <= ByteCursor::kMost;
    const bool ok =
        fixed ? ReadFixed(element, xyz, vertices) : ReadMixedVertices(element, xyz, vertices);
    if (ok) return {};
    return vertices.failed() ? vertices.failure() : cursor_.failure();
  }

  std::optional<std::uint64_t> BytesOf(const PlyElement& element,
                                       std::uint64_t list_length) const override {
    std::uint64_t bytes = 0;
    if (!__builtin_mul_overflow(element.count, RowBytes(element, list_length), &bytes)) {
      return bytes;
    }
    return {};
  }

  void SelectShare(const Share& share) override {
    share_ = share;
    cursor_.LimitAhead(UINT64_MAX);
  }

  void BeginSurface(const PlySurface& surface) override {
    surface_ = surface;
    runs_ = PlanRuns(*surface.element, surface.indices);
    shape_ = surface.strips ? TriangleShape{} : ShapeOf(runs_);
    rows_left_ = surface.element->count;
    run_left_ = share_.whole() ? rows_left_ : 0;
    in_strip_list_ = false;
  }

  Result<bool> ReadSurface(FaceAssembler& faces) override {
    while (rows_left_ > 0 && !faces.full()) {
      if (run_left_ == 0) {
        if (auto ok = EnterRun(faces); !ok) return Forward(ok);
        continue;
      }
      if (shape_.usual) ReadTriangles(faces);
      if (run_left_ == 0 || faces.full()) continue;
      const bool ok = surface_.strips ? ReadStripRow(faces) : ReadFace(faces);
      if (!ok) return cursor_.failure();
    }
    return rows_left_ == 0;
  }

  PlyProgress progress() const override {
    return {mark(), rows_left_, in_strip_list_, strip_left_, run_left_};
  }
  Result<void> Resume(const PlyProgress& progress) override {
    rows_left_ = progress.rows_left;
    run_left_ = progress.run_left;
    if (!share_.whole()) LimitToRun(progress.mark.offset);
    in_strip_list_ = progress.in_strip_list;
    strip_left_ = progress.strip_left;
    return Seek(progress.mark);
  }

 private:
  // Always fits: a header has 16 MiB.
  static std::uint64_t RowBytes(const PlyElement& element, std::uint64_t list_length) {
    std::uint64_t bytes = 0;
    for (const PlyProperty& p : element.properties) {
      bytes += p.is_list ? PlySize(p.count_type) + list_length * PlySize(p.type) : PlySize(p.type);
    }
    return bytes;
  }

  // Goes to the share's next rows, or behind the last of all.
  Result<void> EnterRun(FaceAssembler& faces) {
    const std::uint64_t count = surface_.element->count, from = count - rows_left_;
    const std::uint64_t row = std::min(share_.Next(from), count), passed = row - from;
    const std::uint64_t to = cursor_.offset() + passed * RowBytes(*surface_.element, 3);
    rows_left_ -= passed;
    run_left_ = rows_left_ == 0 ? 0 : std::min(share_.RunEnd(row), count) - row;
    faces.PassOver(passed);
    LimitToRun(to);
    return passed == 0 ? Result<void>() : cursor_.Seek(to);
  }
  void LimitToRun(std::uint64_t offset) {
    if (surface_.element == nullptr) return;
    cursor_.LimitAhead(offset + run_left_ * RowBytes(*surface_.element, 3));
  }
  void NoteRows(std::uint64_t n) {
    rows_left_ -= n;
    run_left_ -= n;
  }

  bool ReadLength(PlyType type, std::uint64_t& length) {
    if (!cursor_.Have(PlySize(type))) return false;
    const std::int64_t n = LoadInteger<kSwap>(type, cursor_.data());
    if (n < 0) return cursor_.Reject("found list length " + std::to_string(n));
    cursor_.Advance(PlySize(type));
    length = static_cast<std::uint64_t>(n);
    return true;
  }

  bool SkipList(const Run& run) {
    std::uint64_t length = 0;
    return ReadLength(run.count_type, length) && SkipBytes(length * PlySize(run.item_type));
  }
  bool SkipBytes(std::uint64_t n) { return n == 0 || cursor_.Skip(n); }
  bool SkipRun(const Run& run) {
    return SkipBytes(run.fixed_bytes) && (!run.has_list || SkipList(run));
  }
  bool SkipRow(const std::vector<Run>& runs) {
    return std::all_of(runs.begin(), runs.end(), [this](const Run& run) { return SkipRun(run); });
  }

  // Vertices all of whose properties have a fixed size, many at a time.
  bool ReadFixed(const PlyElement& element, const std::size_t (&xyz)[3], VertexStore& vertices) {
    PlyVertexRows rows;
    rows.swap = kSwap;
    for (std::size_t i = 0; i < element.properties.size(); ++i) {
      for (std::size_t a = 0; a < 3; ++a) {
        if (xyz[a] == i) rows.axes[a] = {rows.stride, element.properties[i].type};
      }
      rows.stride += PlySize(element.properties[i].type);
    }
    if (!vertices.Fits(element.count, rows.is_double()) && source_.can_read_at()) {
      return LeaveFixed(rows, element.count, vertices);
    }
    for (std::uint64_t left = element.count; left > 0;) {
      if (!cursor_.Have(rows.stride)) return false;
      const auto n = static_cast<std::size_t>(
          std::min<std::uint64_t>(left, cursor_.available() / rows.stride));
      if (!CopyVertices(rows, cursor_.data(), n, vertices)) return false;
      cursor_.Advance(n * rows.stride);
      left -= n;
    }
    return true;
  }

  // Too many for memory: they stay where they are.
  bool LeaveFixed(const PlyVertexRows& rows, std::uint64_t count, VertexStore& vertices) {
    const std::uint64_t offset = cursor_.offset();
    std::uint64_t bytes;
    if (__builtin_mul_overflow(count, std::uint64_t{rows.stride}, &bytes)) {
      return cursor_.Reject("expected more vertices than any file can hold");
    }
    return cursor_.Skip(bytes) && vertices.Adopt(OpenPlyVertexFile(source_, rows, offset, count));
  }

  static bool CopyVertices(const PlyVertexRows& rows, const char* from, std::size_t n,
                           VertexStore& vertices) {
    if (rows.all_float32() && !vertices.array().is_double()) {
      CopyPlyFloats<kSwap>(rows, from, n, vertices.array().ExtendFloat(n).data());
      return vertices.Settle();
    }
    for (; n > 0; --n, from += rows.stride) {
      const auto at = [&](std::size_t a) {
        return LoadNumber<kSwap>(rows.axes[a].type, from + rows.axes[a].offset);
      };
      if (!vertices.Append(at(0), at(1), at(2))) return false;
    }
    return true;
  }

  // Vertices that carry lists, or are wider than the cursor's view: property by property.
  bool ReadMixedVertices(const PlyElement& element, const std::size_t (&xyz)[3],
                         VertexStore& vertices) {
    for (std::uint64_t left = element.count; left > 0; --left) {
      Vec3 v;
      for (std::size_t i = 0; i < element.properties.size(); ++i) {
        const PlyProperty& p = element.properties[i];
        if (p.is_list) {
          if (!SkipList({0, true, false, p.count_type, p.type})) return false;
          continue;
        }
        if (!cursor_.Have(PlySize(p.type))) return false;
        for (int a = 0; a < 3; ++a) {
          if (xyz[a] == i) v[a] = LoadNumber<kSwap>(p.type, cursor_.data());
        }
        cursor_.Advance(PlySize(p.type));
      }
      if (!vertices.Append(v.x, v.y, v.z)) return false;
    }
    return true;
  }

  // As many rows of the usual shape as the window, the batch and the data allow at one go.
  void ReadTriangles(FaceAssembler& faces) {
    while (run_left_ > 0 && !faces.full()) {
      // Too few bytes are the business of ReadFace, which says what is missing.
      if (cursor_.available() < shape_.stride) return;
      const auto n = static_cast<std::size_t>(
          std::min<std::uint64_t>({run_left_, cursor_.available() / shape_.stride, faces.Room()}));
      const char* rows = cursor_.data() + shape_.before;
      const std::size_t done =
          faces.far() == nullptr ? GatherNear(rows, n, faces) : GatherFar(rows, n, faces);
      faces.NoteTriangles(done);
      cursor_.Advance(done * shape_.stride);
      NoteRows(done);
      if (done < n || n == 0) return;
    }
  }

  std::size_t GatherNear(const char* rows, std::size_t n, FaceAssembler& faces) const {
    const VertexView& vertices = faces.vertices();
    return vertices.f64.empty() ? Gather(rows, n, vertices.f32, faces.next_id(), faces.batch())
                                : Gather(rows, n, vertices.f64, faces.next_id(), faces.batch());
  }

  std::size_t GatherFar(const char* rows, std::size_t n, FaceAssembler& faces) const {
    const RowsOfTriangles in{rows, shape_.stride, n, faces.vertex_count()};
    if (faces.scouting()) return RecordTriangles<kSwap>(in, *faces.far());
    return faces.far()->WithFetch([&](auto&& fetch) {
      return FetchTriangles<kSwap>(in, fetch, faces.next_id(), faces.batch());
    });
  }

  template <class Scalar>
  std::size_t Gather(const char* rows, std::size_t n, std::span<const Scalar> vertices,
                     std::uint64_t first_id, TriangleBatch& batch) const {
    // A stride known at compile time for the most common file of all.
    return shape_.stride == kTriangleBytes
               ? GatherTriangles<kSwap>(rows, kTriangleBytes, n, vertices, first_id, batch)
               : GatherTriangles<kSwap>(rows, shape_.stride, n, vertices, first_id, batch);
  }

  // A face of any shape.
  bool ReadFace(FaceAssembler& faces) {
    for (const Run& run : runs_) {
      if (!run.wanted) {
        if (!SkipRun(run)) return false;
        continue;
      }
      if (!SkipBytes(run.fixed_bytes) || !ReadCorners(run)) return false;
    }
    NoteRows(1);
    faces.AddFace(corners_);
    return true;
  }

  bool ReadCorners(const Run& run) {
    std::uint64_t length = 0;
    const std::uint64_t at = cursor_.offset();
    if (!ReadLength(run.count_type, length)) return false;
    if (length > kMaxPlyCorners) {
      return cursor_.Reject("found a face of " + std::to_string(length) + " corners at byte " +
                                std::to_string(at) + ", at most " + std::to_string(kMaxPlyCorners) +
                                " are read",
                            ErrorCode::kUnsupported);
    }
    if (share_.count > 1 && length != 3) return RejectPolygon(length, at);
    corners_.clear();
    const std::size_t size = PlySize(run.item_type);
    for (; length > 0; --length) {
      if (!cursor_.Have(size)) return false;
      corners_.push_back(LoadInteger<kSwap>(run.item_type, cursor_.data()));
      cursor_.Advance(size);
    }
    return true;
  }

  // Rows were passed over as if all of them were triangles.
  bool RejectPolygon(std::uint64_t corners, std::uint64_t at) {
    return cursor_.Reject("found a face of " + std::to_string(corners) + " corners at byte " +
                              std::to_string(at) +
                              ", expected 3, as the file has the size of one of triangles only; a "
                              "mesh of others that has this size cannot be read in shares",
                          ErrorCode::kUnsupported);
  }

  // Goes on with a row of strips, which need not fit a batch or the memory.
  bool ReadStripRow(FaceAssembler& faces) {
    const Run* run = std::find_if(runs_.data(), runs_.data() + runs_.size(),
                                  [](const Run& r) { return r.wanted; });
    if (!in_strip_list_) {
      for (const Run* before = runs_.data(); before != run; ++before) {
        if (!SkipRun(*before)) return false;
      }
      if (!SkipBytes(run->fixed_bytes) || !ReadLength(run->count_type, strip_left_)) return false;
      in_strip_list_ = true;
    }
    if (!ReadStripItems(run->item_type, faces)) return false;
    if (strip_left_ > 0) return true;
    faces.EndStrip();
    in_strip_list_ = false;
    NoteRows(1);
    for (++run; run != runs_.data() + runs_.size(); ++run) {
      if (!SkipRun(*run)) return false;
    }
    return true;
  }

  bool ReadStripItems(PlyType type, FaceAssembler& faces) {
    const std::size_t size = PlySize(type);
    for (; strip_left_ > 0 && !faces.full(); --strip_left_) {
      if (!cursor_.Have(size)) return false;
      const std::int64_t index = LoadInteger<kSwap>(type, cursor_.data());
      cursor_.Advance(size);
      if (IsStripEnd(index, type)) {
        faces.EndStrip();
      } else {
        faces.AddStripCorner(index);
      }
    }
    return true;
  }

  ByteSource& source_;
  ByteCursor cursor_;
  PlySurface surface_;
  std::vector<Run> runs_;
  TriangleShape shape_;
  Share share_;
  std::uint64_t rows_left_ = 0;
  std::uint64_t run_left_ = 0;  // Of these, so many are the share's and follow each other.
  std::vector<std::int64_t> corners_;
  bool in_strip_list_ = false;
  std::uint64_t strip_left_ = 0;  // Items left of the list being read.
};

}  // namespace

std::unique_ptr<PlyRows> BinaryPlyRows(InputBuffer& input, const PlyHeader& header) {
  if (header.encoding == PlyEncoding::kBigEndian) return std::make_unique<BinaryRows<true>>(input);
  return std::make_unique<BinaryRows<false>>(input);
}

}  // namespace strata::io
