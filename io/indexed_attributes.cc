#include "io/indexed_attributes.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <limits>
#include <utility>

#include "io/triangulate.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::size_t kNoRow = std::numeric_limits<std::size_t>::max();

// What stands for a value that is not there.
void PutAbsent(const MeshAttribute& attribute, char* out) {
  std::memset(out, 0, attribute.bytes());
  const std::size_t n = static_cast<std::size_t>(attribute.components);
  for (std::size_t k = 0; k < n && attribute.type == ScalarType::kFloat32; ++k) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    std::memcpy(out + k * sizeof nan, &nan, sizeof nan);
  }
  for (std::size_t k = 0; k < n && attribute.type == ScalarType::kFloat64; ++k) {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    std::memcpy(out + k * sizeof nan, &nan, sizeof nan);
  }
}

// A face of this call's points: where its parts lie in the call's arrays.
struct KeptFace {
  std::uint64_t first;
  std::size_t corners, rows, values, wedges;
  bool has_values, has_wedges;
};

class IndexedPass final : public AttributePass {
 public:
  IndexedPass(IndexedMesh mesh, std::vector<MeshAttribute> attributes,
              std::vector<AttributeSource> sources, RunContext& context)
      : mesh_(std::move(mesh)),
        attributes_(std::move(attributes)),
        sources_(std::move(sources)),
        context_(context),
        row_of_(mesh_.tables.size()),
        rows_(mesh_.tables.size()),
        uses_(mesh_.tables.size()) {
    for (const AttributeSource& source : sources_) {
      const bool table = source.place == AttributeSource::Place::kTable ||
                         source.place == AttributeSource::Place::kColor;
      if (table) uses_[source.table] = true;
      wants_corners_ = wants_corners_ || source.place != AttributeSource::Place::kFace;
    }
  }

  Result<void> Read(std::span<const SurfacePoint> points, std::span<char* const> out) override {
    if (auto walked = Walk(points); !walked) return walked;
    if (context_.cancelled()) return Cancelled();
    for (std::size_t t = 0; t < mesh_.tables.size(); ++t) {
      auto gathered = mesh_.tables[t]->resident() ? Check(t) : Gather(t);
      if (!gathered) return gathered;
    }
    for (std::size_t i = 0; i < points.size(); ++i) {
      const auto corners = CornersOf(i, points[i].triangle);
      if (!corners) return Forward(corners);
      for (std::size_t k = 0; k < attributes_.size(); ++k) {
        char* const to = out[k] + i * attributes_[k].bytes();
        auto put = Put(k, faces_[face_of_[i]], *corners, points[i].weight, to);
        if (!put) return put;
      }
    }
    return mesh_.colors == nullptr ? Result<void>() : mesh_.colors->Flush();
  }

 private:
  using Corners = std::array<std::size_t, 3>;

  // Finds the points' faces, each once.
  Result<void> Walk(std::span<const SurfacePoint> points) {
    faces_.clear();
    face_of_.clear();
    corner_rows_.clear();
    values_.clear();
    wedges_.clear();
    polygon_ = kNoRow;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (i == 0 || points[i].triangle != points[i - 1].triangle) {
        if (auto found = mesh_.faces->GoTo(points[i].triangle, face_); !found) return found;
        Keep();
      }
      face_of_.push_back(faces_.size() - 1);
    }
    return {};
  }

  void Keep() {
    if (!faces_.empty() && faces_.back().first == face_.first) return;
    faces_.push_back({face_.first, face_.corners, corner_rows_.size(), values_.size(),
                      wedges_.size(), !face_.values.empty(), !face_.wedges.empty()});
    corner_rows_.insert(corner_rows_.end(), face_.rows.begin(), face_.rows.end());
    values_.insert(values_.end(), face_.values.begin(), face_.values.end());
    wedges_.insert(wedges_.end(), face_.wedges.begin(), face_.wedges.end());
  }

  // Whether table `t` is asked about a face: the first one also for where a polygon's corners are.
  bool Uses(std::size_t t, const KeptFace& face) const {
    return uses_[t] || (t == 0 && wants_corners_ && face.corners > 3);
  }

  // Whether a table that is in memory has all that the kept faces name.
  Result<void> Check(std::size_t t) const {
    for (const KeptFace& face : faces_) {
      if (!Uses(t, face)) continue;
      for (std::size_t c = 0; c < face.corners; ++c) {
        const std::int64_t row = corner_rows_[face.rows + t * face.corners + c];
        if (row >= 0 && static_cast<std::uint64_t>(row) >= mesh_.tables[t]->size()) {
          return OutOfRange(row);
        }
      }
    }
    return {};
  }

  // Reads the rows that the kept faces name, each once and in the order of the file.
  Result<void> Gather(std::size_t t) {
    std::vector<std::pair<std::uint64_t, std::size_t>> asked;  // Row, and which corner asks.
    for (const KeptFace& face : faces_) {
      if (!Uses(t, face)) continue;
      for (std::size_t c = 0; c < face.corners; ++c) {
        const std::size_t place = face.rows + t * face.corners + c;
        const std::int64_t row = corner_rows_[place];
        if (row < 0) continue;
        if (static_cast<std::uint64_t>(row) >= mesh_.tables[t]->size()) return OutOfRange(row);
        asked.emplace_back(static_cast<std::uint64_t>(row), place);
      }
    }
    std::sort(asked.begin(), asked.end());
    std::vector<std::uint64_t> numbers;
    // By a corner's place; the tables' corners do not overlap.
    std::vector<std::size_t>& row_of = row_of_[t];
    row_of.assign(asked.empty() ? 0 : corner_rows_.size(), kNoRow);
    for (const auto& [row, place] : asked) {
      if (numbers.empty() || numbers.back() != row) numbers.push_back(row);
      row_of[place] = numbers.size() - 1;
    }
    rows_[t].resize(numbers.size() * mesh_.tables[t]->row_bytes());
    return mesh_.tables[t]->Gather(numbers, rows_[t].data());
  }

  tl::unexpected<Error> OutOfRange(std::int64_t row) const {
    return Fail(ErrorCode::kCorruptInput,
                mesh_.name + ": found corner " + std::to_string(row) +
                    " in a face, whose attributes do not exist; did the file change meanwhile?");
  }

  const char* RowOf(std::size_t t, const KeptFace& face, std::size_t corner) const {
    const std::size_t place = face.rows + t * face.corners + corner;
    if (mesh_.tables[t]->resident()) {
      const std::int64_t row = corner_rows_[place];
      return row < 0 ? nullptr : mesh_.tables[t]->Row(static_cast<std::uint64_t>(row));
    }
    if (row_of_[t].empty() || row_of_[t][place] == kNoRow) return nullptr;
    return rows_[t].data() + row_of_[t][place] * mesh_.tables[t]->row_bytes();
  }

  // Which of its face's corners the triangle of point `i` has.
  Result<Corners> CornersOf(std::size_t i, std::uint64_t triangle) {
    const KeptFace& face = faces_[face_of_[i]];
    if (face.corners == 3 || !wants_corners_) return Corners{0, 1, 2};
    if (polygon_ != face_of_[i]) {
      std::vector<Vec3> corners;
      for (std::size_t c = 0; c < face.corners; ++c) {
        const char* const row = RowOf(0, face, c);
        if (row == nullptr) return OutOfRange(-1);
        const auto& at = mesh_.position;
        corners.push_back({at[0].Number(row, 0), at[1].Number(row, 0), at[2].Number(row, 0)});
      }
      pieces_.clear();
      TriangulatePolygon(corners, pieces_);
      polygon_ = face_of_[i];
    }
    const auto& piece = pieces_[triangle - face.first];
    return Corners{piece[0], piece[1], piece[2]};
  }

  // What there is of texture coordinates; without any they are NaN.
  Result<void> PutColor(const AttributeSource& source, const KeptFace& face, const Corners& corners,
                        const std::array<double, 3>& weight, char* out) {
    std::array<std::array<double, 2>, 3> corner;
    for (std::size_t v = 0; v < 3; ++v) {
      corner[v].fill(std::numeric_limits<double>::quiet_NaN());
      const char* const row = RowOf(source.table, face, corners[v]);
      if (row != nullptr) corner[v] = {source.field.Number(row, 0), source.field.Number(row, 1)};
    }
    const auto [u, v] = CarryUv(corner, weight);
    const double material = mesh_.material.Number(values_.data() + face.values, 0);
    return mesh_.colors->Add(static_cast<std::uint32_t>(material), u, v, out);
  }

  Result<void> Put(std::size_t k, const KeptFace& face, const Corners& corners,
                   const std::array<double, 3>& weight, char* out) {
    const MeshAttribute& attribute = attributes_[k];
    const AttributeSource& source = sources_[k];
    if (source.place == AttributeSource::Place::kColor) {
      return PutColor(source, face, corners, weight, out);
    }
    std::array<const char*, 3> value{};
    for (std::size_t v = 0; v < 3; ++v) {
      const char* const row = RowFor(source, face, corners[v]);
      if (row == nullptr) return PutAbsent(attribute, out), Result<void>();
      char* const copy = scratch_.data() + v * attribute.bytes();
      source.field.Copy(row, copy);
      value[v] = copy;
      if (attribute.carry == Carry::kConstant) break;
    }
    CarryValue(attribute, value, weight, out);
    return {};
  }

  // Null if there is none.
  const char* RowFor(const AttributeSource& source, const KeptFace& face,
                     std::size_t corner) const {
    switch (source.place) {
      case AttributeSource::Place::kFace:
        return face.has_values ? values_.data() + face.values : nullptr;
      case AttributeSource::Place::kWedge:
        return face.has_wedges ? wedges_.data() + face.wedges + corner * mesh_.wedge_bytes
                               : nullptr;
      default:
        return RowOf(source.table, face, corner);
    }
  }

  IndexedMesh mesh_;
  const std::vector<MeshAttribute> attributes_;
  const std::vector<AttributeSource> sources_;
  RunContext& context_;

  // Of one call:
  AttributedFace face_;
  std::vector<KeptFace> faces_;
  std::vector<std::size_t> face_of_;              // Of each point.
  std::vector<std::int64_t> corner_rows_;         // AttributedFace::rows of all faces, …
  std::vector<char> values_, wedges_;             // … and their values.
  std::vector<std::vector<std::size_t>> row_of_;  // By table: a corner's row among …
  std::vector<std::vector<char>> rows_;           // … those that were read.
  std::vector<bool> uses_;                        // Which tables attributes come from.
  std::size_t polygon_ = kNoRow;                  // The face that pieces_ cuts up.
  std::vector<std::array<std::uint32_t, 3>> pieces_;
  bool wants_corners_ = false;
  std::array<char, std::size_t{3} * 8 * kMostComponents> scratch_{};  // Values of three corners.
};

template <class Bits>
void CopyScalar(const char* from, bool swap, char* to) {
  Bits bits;
  std::memcpy(&bits, from, sizeof bits);
  if (swap) {
    if constexpr (sizeof bits == 2) bits = __builtin_bswap16(bits);
    if constexpr (sizeof bits == 4) bits = __builtin_bswap32(bits);
    if constexpr (sizeof bits == 8) bits = __builtin_bswap64(bits);
  }
  std::memcpy(to, &bits, sizeof bits);
}

void CopyScalar(ScalarType type, const char* from, bool swap, char* to) {
  switch (SizeOf(type)) {
    case 1:
      return CopyScalar<std::uint8_t>(from, swap, to);
    case 2:
      return CopyScalar<std::uint16_t>(from, swap, to);
    case 4:
      return CopyScalar<std::uint32_t>(from, swap, to);
    default:
      return CopyScalar<std::uint64_t>(from, swap, to);
  }
}

}  // namespace

void RowField::Copy(const char* row, char* out) const {
  const std::size_t size = SizeOf(type);
  for (const std::size_t at : offset) {
    CopyScalar(type, row + at, swap, out);
    out += size;
  }
}

double RowField::Number(const char* row, std::size_t k) const {
  char value[8];
  CopyScalar(type, row + offset[k], swap, value);
  return WithType(type, [&](auto number) {
    std::memcpy(&number, value, sizeof number);
    return static_cast<double>(number);
  });
}

std::unique_ptr<AttributePass> PassOver(IndexedMesh mesh, std::vector<MeshAttribute> attributes,
                                        std::vector<AttributeSource> sources, RunContext& context) {
  return std::make_unique<IndexedPass>(std::move(mesh), std::move(attributes), std::move(sources),
                                       context);
}

}  // namespace strata::io
