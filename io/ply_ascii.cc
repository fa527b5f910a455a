#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "io/ascii_cursor.h"
#include "io/ply_rows.h"

namespace strata::io {
namespace {

// What to do with a property's token or tokens.
enum class Use : std::uint8_t { kPass, kPassList, kX, kY, kZ, kCorners };

struct Step {
  Use use = Use::kPass;
  const PlyProperty* property = nullptr;
};

std::vector<Step> PlanSteps(const PlyElement& element) {
  std::vector<Step> steps;
  for (const PlyProperty& p : element.properties) {
    steps.push_back({p.is_list ? Use::kPassList : Use::kPass, &p});
  }
  return steps;
}

struct Range {
  std::int64_t least, most;
};

Range RangeOf(PlyType type) {
  constexpr std::array kRanges = {
      Range{-128, 127},
      Range{0, 255},
      Range{-32768, 32767},
      Range{0, 65535},
      Range{std::numeric_limits<std::int32_t>::min(), std::numeric_limits<std::int32_t>::max()},
      Range{0, std::numeric_limits<std::uint32_t>::max()}};
  return kRanges[static_cast<std::size_t>(type)];
}

class AsciiRows : public PlyRows {
 public:
  AsciiRows(InputBuffer& input, const PlyHeader& header) : cursor_(input, header.newline) {
    // The cursor counts lines from where it is told to stand.
    static_cast<void>(cursor_.Seek(header.data_offset, header.data_line));
  }

  PlyMark mark() const override { return {cursor_.offset(), cursor_.line()}; }
  Result<void> Seek(const PlyMark& mark) override { return cursor_.Seek(mark.offset, mark.line); }

  Result<void> Skip(const PlyElement& element) override {
    if (element.properties.empty()) return {};
    const std::vector<Step> steps = PlanSteps(element);
    for (std::uint64_t left = element.count; left > 0; --left) {
      if (!BeginRow(element, left) || !PassSteps(steps, 0) || !cursor_.ExpectLineEnd()) {
        return cursor_.failure();
      }
    }
    return {};
  }

  Result<void> ReadVertices(const PlyElement& element, const std::size_t (&xyz)[3],
                            VertexStore& vertices) override {
    std::vector<Step> steps = PlanSteps(element);
    for (std::size_t a = 0; a < 3; ++a) {
      steps[xyz[a]].use = static_cast<Use>(static_cast<std::size_t>(Use::kX) + a);
    }
    const bool floats = std::all_of(xyz, xyz + 3, [&](std::size_t i) {
      return element.properties[i].type == PlyType::kFloat32;
    });
    const bool ok = floats ? ReadPoints<float>(element, steps, vertices)
                           : ReadPoints<double>(element, steps, vertices);
    if (ok) return {};
    return vertices.failed() ? vertices.failure() : cursor_.failure();
  }

  std::optional<std::uint64_t> BytesOf(const PlyElement&, std::uint64_t) const override {
    return {};
  }
  void SelectShare(const Share&) override {}

  void BeginSurface(const PlySurface& surface) override {
    surface_ = surface;
    steps_ = PlanSteps(*surface.element);
    steps_[surface.indices].use = Use::kCorners;
    rows_left_ = surface.element->count;
    in_strip_list_ = false;
  }

  Result<bool> ReadSurface(FaceAssembler& faces) override {
    while (rows_left_ > 0 && !faces.full()) {
      const bool ok = surface_.strips ? ReadStripRow(faces) : ReadFace(faces);
      if (!ok) return cursor_.failure();
    }
    return rows_left_ == 0;
  }

  PlyProgress progress() const override {
    return {mark(), rows_left_, in_strip_list_, strip_left_};
  }
  Result<void> Resume(const PlyProgress& progress) override {
    rows_left_ = progress.rows_left;
    in_strip_list_ = progress.in_strip_list;
    strip_left_ = progress.strip_left;
    return Seek(progress.mark);
  }

  Result<void> CheckEnd() override {
    if (cursor_.NextRow()) {
      cursor_.Reject("expected the end of the file after all that was announced");
      return cursor_.failure();
    }
    return cursor_.at_end() ? Result<void>() : cursor_.failure();
  }

 private:
  bool BeginRow(const PlyElement& element, std::uint64_t left) {
    if (cursor_.NextRow()) return true;
    if (!cursor_.at_end()) return false;
    return cursor_.Reject("expected " + std::to_string(left) + " more of '" + element.name + "'");
  }

  bool ReadInteger(PlyType type, std::int64_t& value) {
    const Range range = RangeOf(type);
    return cursor_.ReadInteger(value, range.least, range.most);
  }

  bool ReadLength(const PlyProperty& p, std::uint64_t& length) {
    std::int64_t n = 0;
    if (!cursor_.ReadInteger(n, 0, RangeOf(p.count_type).most)) return false;
    length = static_cast<std::uint64_t>(n);
    return true;
  }

  bool PassSteps(const std::vector<Step>& steps, std::size_t from) {
    for (; from < steps.size(); ++from) {
      if (!PassStep(steps[from])) return false;
    }
    return true;
  }

  bool PassStep(const Step& step) {
    std::uint64_t tokens = 1;
    if (step.use == Use::kPassList && !ReadLength(*step.property, tokens)) return false;
    for (; tokens > 0; --tokens) {
      if (!cursor_.SkipToken()) return false;
    }
    return true;
  }

  bool ReadCoordinate(PlyType type, float& value) { return cursor_.ReadFloat(value); }
  bool ReadCoordinate(PlyType type, double& value) {
    if (type == PlyType::kFloat64) return cursor_.ReadDouble(value);
    if (type == PlyType::kFloat32) {
      float single = 0;
      if (!cursor_.ReadFloat(single)) return false;
      value = static_cast<double>(single);
      return true;
    }
    std::int64_t whole = 0;
    if (!ReadInteger(type, whole)) return false;
    value = static_cast<double>(whole);
    return true;
  }

  template <class Scalar>
  bool ReadPoints(const PlyElement& element, const std::vector<Step>& steps,
                  VertexStore& vertices) {
    for (std::uint64_t left = element.count; left > 0; --left) {
      if (!BeginRow(element, left)) return false;
      Scalar xyz[3] = {};
      for (const Step& step : steps) {
        const bool axis = step.use >= Use::kX && step.use <= Use::kZ;
        const std::size_t a =
            static_cast<std::size_t>(step.use) - static_cast<std::size_t>(Use::kX);
        if (axis ? !ReadCoordinate(step.property->type, xyz[a]) : !PassStep(step)) return false;
      }
      if (!cursor_.ExpectLineEnd()) return false;
      if (!AppendPoint(xyz, vertices)) return false;
    }
    return true;
  }

  static bool AppendPoint(const float (&xyz)[3], VertexStore& vertices) {
    std::copy_n(xyz, 3, vertices.array().ExtendFloat(1).data());
    return vertices.Settle();
  }
  static bool AppendPoint(const double (&xyz)[3], VertexStore& vertices) {
    return vertices.Append(xyz[0], xyz[1], xyz[2]);
  }

  bool ReadFace(FaceAssembler& faces) {
    if (!BeginRow(*surface_.element, rows_left_)) return false;
    for (const Step& step : steps_) {
      if (step.use == Use::kCorners ? !ReadCorners(*step.property) : !PassStep(step)) return false;
    }
    if (!cursor_.ExpectLineEnd()) return false;
    --rows_left_;
    faces.AddFace(corners_);
    return true;
  }

  bool ReadCorners(const PlyProperty& p) {
    std::uint64_t length = 0;
    if (!ReadLength(p, length)) return false;
    if (length > kMaxPlyCorners) {
      return cursor_.Fault("found a face of " + std::to_string(length) + " corners, at most " +
                               std::to_string(kMaxPlyCorners) + " are read",
                           ErrorCode::kUnsupported);
    }
    corners_.clear();
    for (; length > 0; --length) {
      std::int64_t index = 0;
      if (!ReadInteger(p.type, index)) return false;
      corners_.push_back(index);
    }
    return true;
  }

  // Goes on with a row of strips, which need not fit a batch or the memory.
  bool ReadStripRow(FaceAssembler& faces) {
    const PlyProperty& p = *steps_[surface_.indices].property;
    if (!in_strip_list_) {
      if (!BeginRow(*surface_.element, rows_left_)) return false;
      for (std::size_t i = 0; i < surface_.indices; ++i) {
        if (!PassStep(steps_[i])) return false;
      }
      if (!ReadLength(p, strip_left_)) return false;
      in_strip_list_ = true;
    }
    if (!ReadStripItems(p.type, faces)) return false;
    if (strip_left_ > 0) return true;
    faces.EndStrip();
    in_strip_list_ = false;
    --rows_left_;
    return PassSteps(steps_, surface_.indices + 1) && cursor_.ExpectLineEnd();
  }

  bool ReadStripItems(PlyType type, FaceAssembler& faces) {
    for (; strip_left_ > 0 && !faces.full(); --strip_left_) {
      std::int64_t index = 0;
      if (!ReadInteger(type, index)) return false;
      if (IsStripEnd(index, type)) {
        faces.EndStrip();
      } else {
        faces.AddStripCorner(index);
      }
    }
    return true;
  }

  AsciiCursor cursor_;
  PlySurface surface_;
  std::vector<Step> steps_;
  std::uint64_t rows_left_ = 0;
  std::vector<std::int64_t> corners_;
  bool in_strip_list_ = false;
  std::uint64_t strip_left_ = 0;  // Items left of the list being read.
};

}  // namespace

std::unique_ptr<PlyRows> AsciiPlyRows(InputBuffer& input, const PlyHeader& header) {
  return std::make_unique<AsciiRows>(input, header);
}

}  // namespace strata::io
