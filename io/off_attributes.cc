#include "io/off_attributes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <utility>

#include "io/decimal.h"
#include "io/index_token.h"
#include "io/indexed_attributes.h"
#include "io/text_scanner.h"

namespace strata::io {
namespace {

constexpr std::size_t kMostBehind = 9;  // Numbers behind the coordinates.
// A table's row: position, normal, UV, colour.
constexpr std::size_t kNormalAt = 3 * sizeof(double), kUvAt = kNormalAt + 3 * sizeof(float),
                      kColorAt = kUvAt + 2 * sizeof(float),
                      kRowBytes = kColorAt + 4 * sizeof(float);

// Goes to the next line that has something besides a comment.
bool NextLine(TextScanner& text, std::string_view& line) {
  while (text.Next()) {
    line = text.line();
    const std::size_t comment = line.find('#');
    line = line.substr(0, comment);
    const char* const last = line.data() + line.size();
    const char* const first = SkipBlanks(line.data(), last);
    if (first == last) continue;
    line = {first, static_cast<std::size_t>(last - first)};
    return true;
  }
  return false;
}

tl::unexpected<Error> Ended(TextScanner& text) {
  if (!text.failed()) text.Reject("found the end of the file; did it change meanwhile?");
  return text.failure();
}

void PutFloats(const double* numbers, std::size_t n, char* out) {
  for (std::size_t k = 0; k < n; ++k) {
    const float value = static_cast<float>(numbers[k]);
    std::memcpy(out + k * sizeof value, &value, sizeof value);
  }
}

void PutColor(const OffColor& color, const double* numbers, char* out) {
  const auto n = static_cast<std::size_t>(color.components);
  if (!color.bytes) return PutFloats(numbers, n, out);
  for (std::size_t k = 0; k < n; ++k) {
    const double byte = std::isnan(numbers[k]) ? 0 : std::clamp(numbers[k], 0.0, 255.0);
    out[k] = static_cast<char>(static_cast<std::uint8_t>(byte + 0.5));
  }
}

// As many numbers as are there, up to `most`; returns how many.
std::size_t ParseNumbers(const char* p, const char* last, std::size_t most, double* out) {
  for (std::size_t k = 0; k < most; ++k) {
    const char* const end = ParseDecimal(SkipBlanks(p, last), last, out[k]);
    if (end == nullptr) return k;
    p = end;
  }
  return most;
}

class OffFaces final : public FaceWalker {
 public:
  OffFaces(ByteSource& source, std::size_t max_line_bytes, const OffLayout& layout)
      : text_(source, max_line_bytes), layout_(layout) {
    text_.Forget();
  }
  Result<void> Begin(const OffPlaces& places) {
    return text_.Seek(places.faces_offset, places.faces_line);
  }

  Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) override {
    while (triangle >= next_) {
      if (auto ok = Advance(); !ok) return ok;
    }
    face.first = first_;
    face.corners = corners_.size();
    face.rows = corners_;
    face.values = values_;
    return {};
  }

 private:
  Result<void> Advance() {
    std::string_view line;
    if (!NextLine(text_, line)) return Ended(text_);
    const char* const last = line.data() + line.size();
    std::int64_t n = 0;
    const char* p = ParseIndex(line.data(), last, n);
    corners_.clear();
    for (std::int64_t k = 0; p != nullptr && k < n; ++k) {
      p = ParseIndex(SkipBlanks(p, last), last, corners_.emplace_back());
    }
    if (p == nullptr) {
      text_.Reject("expected the numbers of a face; did the file change meanwhile?");
      return text_.failure();
    }
    ParseColor(p, last);
    first_ = next_;
    next_ += corners_.size() < 3 ? 1 : corners_.size() - 2;
    return {};
  }

  // One number of four bytes or up to four of them; none for a face that lacks what the first has.
  void ParseColor(const char* p, const char* last) {
    values_.clear();
    const auto wanted = static_cast<std::size_t>(layout_.face_color.components);
    std::array<double, 4> numbers{};
    if (layout_.face_index && ParseNumbers(p, last, 1, numbers.data()) == 1) {
      values_.resize(sizeof(std::int32_t));
      const bool fits = std::fabs(numbers[0]) <= std::numeric_limits<std::int32_t>::max();
      const std::int32_t index = fits ? static_cast<std::int32_t>(numbers[0]) : 0;
      std::memcpy(values_.data(), &index, sizeof index);
    } else if (wanted > 0 && ParseNumbers(p, last, wanted, numbers.data()) == wanted) {
      values_.resize(4 * sizeof(float));
      PutColor(layout_.face_color, numbers.data(), values_.data());
    }
  }

  TextScanner text_;
  const OffLayout& layout_;
  std::vector<char> values_;
  std::vector<std::int64_t> corners_;
  std::uint64_t first_ = 0, next_ = 0;
};

// What follows the coordinates; what is not there is none.
void PutBehind(const OffLayout& layout, const double* numbers, char* row) {
  if (layout.normal) {
    PutFloats(numbers, 3, row + kNormalAt);
    numbers += 3;
  }
  PutColor(layout.color, numbers, row + kColorAt);
  if (layout.uv) PutFloats(numbers + layout.color.components, 2, row + kUvAt);
}

Result<std::unique_ptr<RowTable>> LoadVertices(ByteSource& source, std::size_t max_line_bytes,
                                               const OffLayout& layout, const OffPlaces& places,
                                               RunContext& context) {
  auto table = std::make_unique<RowTable>(kRowBytes, context);
  TextScanner text(source, max_line_bytes);
  text.Forget();
  if (auto ok = text.Seek(places.vertices_offset, places.vertices_line); !ok) return Forward(ok);
  std::array<double, 3 + kMostBehind> numbers;
  std::array<char, kRowBytes> row{};
  for (std::int64_t i = 0; i < places.vertices; ++i) {
    if (i % 65536 == 0 && context.cancelled()) return Cancelled();
    std::string_view line;
    if (!NextLine(text, line)) return Ended(text);
    numbers.fill(std::numeric_limits<double>::quiet_NaN());
    ParseNumbers(line.data(), line.data() + line.size(), numbers.size(), numbers.data());
    std::memcpy(row.data(), numbers.data(), 3 * sizeof(double));
    PutBehind(layout, numbers.data() + 3, row.data());
    if (auto added = table->Append(row.data()); !added) return Forward(added);
  }
  if (auto done = table->Finish(); !done) return Forward(done);
  return table;
}

AttributeSource SourceOf(const MeshAttribute& attribute) {
  AttributeSource source;
  source.field.type = attribute.type;
  const bool of_faces = attribute.domain == AttributeDomain::kTriangle;
  if (of_faces) source.place = AttributeSource::Place::kFace;
  std::size_t at = kColorAt;
  if (attribute.semantic == Semantic::kNormal) at = kNormalAt;
  if (attribute.semantic == Semantic::kUv) at = kUvAt;
  if (of_faces) at = 0;
  for (int k = 0; k < attribute.components; ++k) {
    source.field.offset.push_back(at + static_cast<std::size_t>(k) * SizeOf(attribute.type));
  }
  return source;
}

MeshAttribute OfVertices(const char* name, int components, Semantic semantic) {
  MeshAttribute attribute;
  attribute.name = name;
  attribute.components = components;
  attribute.semantic = semantic;
  return attribute;
}

MeshAttribute OfColor(const char* name, const OffColor& color) {
  MeshAttribute attribute = OfVertices(name, color.components, Semantic::kColor);
  attribute.color_space = ColorSpace::kSrgb;
  if (color.bytes) attribute.type = ScalarType::kUint8;
  attribute.normalized = color.bytes;
  return attribute;
}

// The words of a line, up to a comment.
std::vector<std::string_view> WordsOf(std::string_view line) {
  std::vector<std::string_view> words;
  const char* const last = line.data() + line.size();
  for (const char* p = SkipBlanks(line.data(), last); p < last && *p != '#';) {
    words.push_back(TokenAt(p, last));
    p = SkipBlanks(p + words.back().size(), last);
  }
  return words;
}

// The colour that stands in the first `components` of `words`.
OffColor ColorOf(std::span<const std::string_view> words, int components) {
  const auto color = words.first(static_cast<std::size_t>(components));
  return {components, std::all_of(color.begin(), color.end(), [](std::string_view word) {
            return std::all_of(word.begin(), word.end(), IsDigit);
          })};
}

}  // namespace

OffLayout OffLayout::Of(bool n, bool c, bool st, std::string_view behind_first) {
  OffLayout layout;
  const std::vector<std::string_view> words = WordsOf(behind_first);
  const std::size_t others = (n ? 3 : 0) + (st ? 2 : 0);
  layout.normal = n;
  layout.uv = st;
  if (!c || words.size() < others + 3) return layout;
  layout.color = ColorOf(std::span(words).subspan(n ? 3 : 0), words.size() == others + 3 ? 3 : 4);
  return layout;
}

void OffLayout::AddFaces(std::string_view first) {
  const std::vector<std::string_view> words = WordsOf(first);
  std::int64_t corners = 0;
  if (words.empty()) return;
  const char* const end = words[0].data() + words[0].size();
  if (ParseIndex(words[0].data(), end, corners) != end || corners < 0) return;
  const auto taken = static_cast<std::uint64_t>(corners) + 1;
  if (words.size() <= taken) return;
  const auto behind = std::span(words).subspan(static_cast<std::size_t>(taken));
  if (behind.size() >= 3) {
    face_color = ColorOf(behind, behind.size() == 3 ? 3 : 4);
  } else if (behind.size() == 1) {
    face_index = ColorOf(behind, 1).bytes;
  }
}

std::vector<MeshAttribute> OffLayout::Attributes() const {
  std::vector<MeshAttribute> attributes;
  if (color.components > 0) attributes.push_back(OfColor("color", color));
  if (normal) attributes.push_back(OfVertices("vertex_normal", 3, Semantic::kNormal));
  if (uv) attributes.push_back(OfVertices("uv", 2, Semantic::kUv));
  const auto of_faces = [&](MeshAttribute attribute) {
    attribute.domain = AttributeDomain::kTriangle;
    attribute.carry = Carry::kConstant;
    attributes.push_back(std::move(attribute));
  };
  if (face_color.components > 0) {
    const bool second = color.components > 0;
    MeshAttribute attribute = OfColor(second ? "face_color" : "color", face_color);
    attribute.set = second ? 1 : 0;
    of_faces(std::move(attribute));
  }
  if (face_index) {
    MeshAttribute attribute = OfVertices("color_index", 1, Semantic::kGeneric);
    attribute.type = ScalarType::kInt32;
    of_faces(std::move(attribute));
  }
  return attributes;
}

Result<std::unique_ptr<AttributePass>> OpenOffAttributes(
    ByteSource& source, std::size_t max_line_bytes, const OffLayout& layout,
    const OffPlaces& places, std::span<const MeshAttribute> wanted, RunContext& context) {
  IndexedMesh mesh;
  mesh.name = source.name();
  for (std::size_t a = 0; a < 3; ++a) {
    mesh.position[a] = {ScalarType::kFloat64, {a * sizeof(double)}, false};
  }
  auto table = LoadVertices(source, max_line_bytes, layout, places, context);
  if (!table) return Forward(table);
  mesh.tables.push_back(std::move(*table));
  auto faces = std::make_unique<OffFaces>(source, max_line_bytes, layout);
  if (auto begun = faces->Begin(places); !begun) return Forward(begun);
  mesh.faces = std::move(faces);
  std::vector<AttributeSource> sources;
  for (const MeshAttribute& attribute : wanted) sources.push_back(SourceOf(attribute));
  return PassOver(std::move(mesh), {wanted.begin(), wanted.end()}, std::move(sources), context);
}

}  // namespace strata::io
