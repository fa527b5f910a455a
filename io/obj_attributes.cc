#include "io/obj_attributes.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <optional>
#include <utility>

#include "io/decimal.h"
#include "io/index_token.h"
#include "io/indexed_attributes.h"
#include "io/text_scanner.h"

namespace strata::io {
namespace {

using Kind = ObjStatement::Kind;

constexpr const char* kTableNames[] = {"group", "object", "material"};
constexpr Semantic kTableSemantics[] = {Semantic::kGroup, Semantic::kObject, Semantic::kMaterial};
constexpr std::size_t kPositionBytes = 3 * sizeof(double), kColorBytes = 3 * sizeof(float);

std::size_t TableOf(Kind kind) {
  return static_cast<std::size_t>(kind) - static_cast<std::size_t>(Kind::kGroup);
}

bool IsNamed(Kind kind) { return kind >= Kind::kGroup; }

std::string_view Trimmed(std::string_view text) {
  while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
  return text;
}

// Up to N numbers; returns how many there are.
template <std::size_t N>
std::size_t Numbers(std::string_view text, std::array<double, N>& out) {
  const char* p = text.data();
  const char* const last = p + text.size();
  std::size_t n = 0;
  while (n < N) {
    p = SkipBlanks(p, last);
    const char* const end = ParseDecimal(p, last, out[n]);
    if (end == nullptr || (end < last && !IsBlank(*end) && *end != '#')) break;
    p = end;
    ++n;
  }
  return n;
}

MeshAttribute OfVertices(const char* name, int components, Semantic semantic,
                         AttributeDomain domain) {
  MeshAttribute attribute;
  attribute.name = name;
  attribute.components = components;
  attribute.semantic = semantic;
  attribute.domain = domain;
  return attribute;
}

// --- The faces ----------------------------------------------------------------------------------

// A corner's numbers in the lists of v, vt and vn, from 0; -1 where there is none.
using ObjCorner = std::array<std::int64_t, 3>;

class ObjFaces final : public FaceWalker {
 public:
  ObjFaces(ByteSource& source, std::size_t max_line_bytes, const ObjContents& contents)
      : text_(source, max_line_bytes), contents_(contents) {}

  Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) override {
    while (triangle >= next_) {
      if (!Advance(triangle)) return text_.failure();
    }
    face.first = first_;
    face.corners = corners_.size();
    face.rows.clear();
    for (std::size_t t = 0; t < 3; ++t) {
      for (const ObjCorner& corner : corners_) face.rows.push_back(corner[t]);
    }
    face.values.resize(sizeof ids_);
    std::memcpy(face.values.data(), ids_, sizeof ids_);
    return {};
  }

 private:
  // Reads on to the next face; false on an error.
  bool Advance(std::uint64_t triangle) {
    for (;;) {
      if (!text_.Next()) {
        return !text_.failed() && text_.Reject("expected triangle " + std::to_string(triangle) +
                                               "; did the file change meanwhile?");
      }
      if (!text_.JoinContinuations()) return false;
      const ObjStatement statement = ClassifyObj(text_.line());
      if (statement.kind == Kind::kFace) return ParseFace(statement.rest);
      Note(statement);
    }
  }

  void Note(const ObjStatement& statement) {
    if (statement.kind == Kind::kVertex) ++count_[0];
    if (statement.kind == Kind::kUv) ++count_[1];
    if (statement.kind == Kind::kNormal) ++count_[2];
    if (!IsNamed(statement.kind)) return;
    const std::size_t t = TableOf(statement.kind);
    ids_[t] = contents_.names(t).Find(Trimmed(statement.rest));
  }

  bool ParseFace(std::string_view rest) {
    corners_.clear();
    const char* const last = rest.data() + rest.size();
    for (const char* p = SkipBlanks(rest.data(), last); p < last && *p != '#';
         p = SkipBlanks(p, last)) {
      ObjCorner corner = {-1, -1, -1};
      p = ParseCorner(p, last, corner);
      if (p == nullptr) return text_.Reject("expected a corner such as 1, 1/2, 1//3 or 1/2/3");
      corners_.push_back(corner);
    }
    first_ = next_;
    next_ += corners_.size() < 3 ? 1 : corners_.size() - 2;
    return true;
  }

  const char* ParseCorner(const char* p, const char* last, ObjCorner& corner) const {
    for (std::size_t t = 0; t < 3; ++t) {
      std::int64_t index = 0;
      if (const char* const end = ParseIndex(p, last, index); end != nullptr) {
        corner[t] = index > 0 ? index - 1 : index == 0 ? -1 : count_[t] + index;
        p = end;
      } else if (t == 0) {
        return nullptr;
      }
      if (p == last || *p != '/') break;
      ++p;
    }
    while (p < last && !IsBlank(*p)) ++p;
    return p;
  }

  TextScanner text_;
  const ObjContents& contents_;
  std::int64_t count_[3] = {0, 0, 0};  // Of v, vt and vn so far.
  std::uint32_t ids_[ObjStatement::kNamed] = {};
  std::vector<ObjCorner> corners_;
  std::uint64_t first_ = 0, next_ = 0;
};

}  // namespace

ObjStatement ClassifyObj(std::string_view line) {
  const char* const last = line.data() + line.size();
  const char* const word = SkipBlanks(line.data(), last);
  const char* end = word;
  while (end < last && !IsBlank(*end)) ++end;
  const std::string_view keyword(word, static_cast<std::size_t>(end - word));
  const std::string_view rest(end, static_cast<std::size_t>(last - end));
  if (keyword == "v") return {Kind::kVertex, rest};
  if (keyword == "f" || keyword == "fo") return {Kind::kFace, rest};
  if (keyword == "vt") return {Kind::kUv, rest};
  if (keyword == "vn") return {Kind::kNormal, rest};
  if (keyword == "g") return {Kind::kGroup, rest};
  if (keyword == "o") return {Kind::kObject, rest};
  if (keyword == "usemtl") return {Kind::kMaterial, rest};
  return {Kind::kOther, rest};
}

std::uint32_t ObjNames::Find(std::string_view name) const {
  const auto found = numbers_.find(name);
  return found == numbers_.end() ? 0 : found->second;
}

std::uint32_t ObjNames::Add(std::string_view name) {
  if (const auto found = numbers_.find(name); found != numbers_.end()) return found->second;
  const auto number = static_cast<std::uint32_t>(list_.size());
  numbers_.emplace(name, number);
  list_.emplace_back(name);
  return number;
}

void ObjNames::AddDefault() {
  if (list_.empty()) static_cast<void>(Add("default"));
}

void ObjContents::Note(const ObjStatement& statement) {
  switch (statement.kind) {
    case Kind::kVertex: {
      // The first vertex tells of all.
      if (std::exchange(seen_vertex_, true)) return;
      std::array<double, 7> numbers;
      has_color_ = Numbers(statement.rest, numbers) == 6;
      return;
    }
    case Kind::kUv:
      has_uv_ = true;
      return;
    case Kind::kNormal:
      has_normal_ = true;
      return;
    case Kind::kFace:
      for (ObjNames& names : names_) names.AddDefault();
      return;
    case Kind::kOther:
      return;
    default:
      break;
  }
  const std::size_t t = TableOf(statement.kind);
  ObjNames& names = names_[t];
  names.AddDefault();
  if (names.list().size() < ObjNames::kMost) {
    static_cast<void>(names.Add(Trimmed(statement.rest)));
  } else if (names.Find(Trimmed(statement.rest)) == 0) {
    too_many_[t] = true;
  }
}

std::vector<MeshAttribute> ObjContents::Attributes() const {
  std::vector<MeshAttribute> attributes;
  if (has_color_) {
    attributes.push_back(OfVertices("color", 3, Semantic::kColor, AttributeDomain::kVertex));
    attributes.back().color_space = ColorSpace::kSrgb;
  }
  if (has_uv_) {
    attributes.push_back(OfVertices("uv", 2, Semantic::kUv, AttributeDomain::kCorner));
  }
  if (has_normal_) {
    attributes.push_back(
        OfVertices("vertex_normal", 3, Semantic::kNormal, AttributeDomain::kCorner));
  }
  for (std::size_t t = 0; t < ObjStatement::kNamed; ++t) {
    // Nothing but the default is nothing.
    if (names_[t].list().size() < 2 || too_many_[t]) continue;
    MeshAttribute id =
        OfVertices(kTableNames[t], 1, kTableSemantics[t], AttributeDomain::kTriangle);
    id.type = ScalarType::kUint32;
    id.carry = Carry::kConstant;
    id.names = names_[t].list();
    attributes.push_back(std::move(id));
  }
  return attributes;
}

namespace {

class ObjPassOpener {
 public:
  ObjPassOpener(ByteSource& source, std::size_t max_line_bytes, const ObjColors& obj_colors,
                RunContext& context)
      : source_(source),
        max_line_bytes_(max_line_bytes),
        obj_colors_(obj_colors),
        context_(context) {}

  Result<std::unique_ptr<AttributePass>> Open(const ObjContents& contents,
                                              std::span<const MeshAttribute> wanted) {
    bool corners = false;
    for (const MeshAttribute& attribute : wanted) {
      sources_.push_back(SourceOf(attribute));
      corners = corners || attribute.carry != Carry::kConstant;
    }
    mesh_.name = source_.name();
    for (std::size_t a = 0; a < 3; ++a) {
      mesh_.position[a] = {ScalarType::kFloat64, {a * sizeof(double)}, false};
    }
    const std::size_t bytes[] = {kPositionBytes + (colors_ ? kColorBytes : 0), 2 * sizeof(float),
                                 3 * sizeof(float)};
    for (const std::size_t row : bytes) {
      mesh_.tables.push_back(std::make_unique<RowTable>(row, context_));
    }
    if (corners) {
      if (auto loaded = LoadTables(); !loaded) return Forward(loaded);
    }
    if (auto ok = source_.Seek(0); !ok) return Forward(ok);
    mesh_.faces = std::make_unique<ObjFaces>(source_, max_line_bytes_, contents);
    return PassOver(std::move(mesh_), {wanted.begin(), wanted.end()}, std::move(sources_),
                    context_);
  }

 private:
  AttributeSource SourceOf(const MeshAttribute& attribute) {
    AttributeSource source;
    if (attribute.carry == Carry::kLookedUp) return LookedUp(attribute);
    source.field.type = attribute.type;
    std::size_t at = 0;
    if (attribute.carry == Carry::kConstant) {
      source.place = AttributeSource::Place::kFace;
      const auto* const table =
          std::find(std::begin(kTableSemantics), std::end(kTableSemantics), attribute.semantic);
      at = static_cast<std::size_t>(table - std::begin(kTableSemantics)) * sizeof(std::uint32_t);
    } else if (attribute.semantic == Semantic::kColor) {
      colors_ = true;
      at = kPositionBytes;
    } else {
      source.table = attribute.semantic == Semantic::kUv ? 1 : 2;
      used_[source.table] = true;
    }
    for (int k = 0; k < attribute.components; ++k) {
      source.field.offset.push_back(at + static_cast<std::size_t>(k) * SizeOf(attribute.type));
    }
    return source;
  }

  AttributeSource LookedUp(const MeshAttribute& attribute) {
    constexpr std::size_t kMaterials = 2;  // Among a face's ids.
    mesh_.material = {ScalarType::kUint32, {kMaterials * sizeof(std::uint32_t)}, false};
    mesh_.colors = std::make_unique<BaseColorLookup>(*obj_colors_.images, obj_colors_.materials,
                                                     attribute.components, context_);
    used_[1] = true;
    return {AttributeSource::Place::kColor, 1, {ScalarType::kFloat32, {0, sizeof(float)}, false}};
  }

  Result<void> LoadTables() {
    if (auto ok = source_.Seek(0); !ok) return ok;
    TextScanner text(source_, max_line_bytes_);
    while (text.Next()) {
      if (text.line_number() % 65536 == 0 && context_.cancelled()) return Cancelled();
      if (!text.JoinContinuations()) return text.failure();
      const ObjStatement statement = ClassifyObj(text.line());
      Result<void> added;
      if (statement.kind == Kind::kVertex) added = AddVertex(statement.rest);
      if (statement.kind == Kind::kUv && used_[1]) added = AddFloats<2>(statement.rest, 1);
      if (statement.kind == Kind::kNormal && used_[2]) added = AddFloats<3>(statement.rest, 2);
      if (!added) return added;
    }
    if (text.failed()) return text.failure();
    for (const auto& table : mesh_.tables) {
      if (auto done = table->Finish(); !done) return done;
    }
    return {};
  }

  Result<void> AddVertex(std::string_view rest) {
    std::array<double, 7> numbers;
    const std::size_t n = Numbers(rest, numbers);
    char row[kPositionBytes + kColorBytes];
    std::memcpy(row, numbers.data(), kPositionBytes);
    PutFloats(numbers.data() + 3, n == 6 ? 3 : 0, 3, row + kPositionBytes);
    return mesh_.tables[0]->Append(row);
  }
  template <std::size_t N>
  Result<void> AddFloats(std::string_view rest, std::size_t table) {
    std::array<double, N> numbers;
    char row[N * sizeof(float)];
    std::size_t given = Numbers(rest, numbers);
    // Of a UV the second is 0 where the file leaves it out.
    if (N == 2 && given == 1) numbers[given++] = 0;
    PutFloats(numbers.data(), given, N, row);
    return mesh_.tables[table]->Append(row);
  }
  // `given` of `n` numbers are there; the rest is none.
  static void PutFloats(const double* numbers, std::size_t given, std::size_t n, char* out) {
    for (std::size_t k = 0; k < n; ++k) {
      const float value =
          k < given ? static_cast<float>(numbers[k]) : std::numeric_limits<float>::quiet_NaN();
      std::memcpy(out + k * sizeof value, &value, sizeof value);
    }
  }

  ByteSource& source_;
  const std::size_t max_line_bytes_;
  const ObjColors& obj_colors_;
  RunContext& context_;
  IndexedMesh mesh_;
  std::vector<AttributeSource> sources_;
  bool colors_ = false;
  bool used_[3] = {true, false, false};
};

}  // namespace

Result<std::unique_ptr<AttributePass>> OpenObjAttributes(
    ByteSource& source, std::size_t max_line_bytes, const ObjContents& contents,
    const ObjColors& colors, std::span<const MeshAttribute> wanted, RunContext& context) {
  return ObjPassOpener(source, max_line_bytes, colors, context).Open(contents, wanted);
}

}  // namespace strata::io
