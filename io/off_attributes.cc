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

class OffFaces final : public FaceWalker {
 public:
  OffFaces(ByteSource& source, std::size_t max_line_bytes) : text_(source, max_line_bytes) {
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
    first_ = next_;
    next_ += corners_.size() < 3 ? 1 : corners_.size() - 2;
    return {};
  }

  TextScanner text_;
  std::vector<std::int64_t> corners_;
  std::uint64_t first_ = 0, next_ = 0;
};

void PutFloats(const double* numbers, std::size_t n, char* out) {
  for (std::size_t k = 0; k < n; ++k) {
    const float value = static_cast<float>(numbers[k]);
    std::memcpy(out + k * sizeof value, &value, sizeof value);
  }
}

// What follows the coordinates; what is not there is none.
void PutBehind(const OffLayout& layout, const double* numbers, char* row) {
  if (layout.normal) {
    PutFloats(numbers, 3, row + kNormalAt);
    numbers += 3;
  }
  if (layout.color_bytes) {
    for (int k = 0; k < layout.color; ++k) {
      const double byte = std::isnan(numbers[k]) ? 0 : std::clamp(numbers[k], 0.0, 255.0);
      row[kColorAt + static_cast<std::size_t>(k)] =
          static_cast<char>(static_cast<std::uint8_t>(byte + 0.5));
    }
  } else {
    PutFloats(numbers, static_cast<std::size_t>(layout.color), row + kColorAt);
  }
  if (layout.uv) PutFloats(numbers + layout.color, 2, row + kUvAt);
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
    const char* p = line.data();
    const char* const last = p + line.size();
    for (std::size_t k = 0; k < numbers.size(); ++k) {
      const char* const end = ParseDecimal(SkipBlanks(p, last), last, numbers[k]);
      if (end == nullptr) break;
      p = end;
    }
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
  const std::size_t at = attribute.semantic == Semantic::kNormal ? kNormalAt
                         : attribute.semantic == Semantic::kUv   ? kUvAt
                                                                 : kColorAt;
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

}  // namespace

OffLayout OffLayout::Of(bool n, bool c, bool st, std::string_view behind_first) {
  OffLayout layout;
  std::vector<std::string_view> tokens;
  const char* const last = behind_first.data() + behind_first.size();
  for (const char* p = SkipBlanks(behind_first.data(), last); p < last && *p != '#';) {
    tokens.push_back(TokenAt(p, last));
    p = SkipBlanks(p + tokens.back().size(), last);
  }
  const std::size_t others = (n ? 3 : 0) + (st ? 2 : 0);
  layout.normal = n;
  layout.uv = st;
  if (!c || tokens.size() < others + 3) return layout;
  layout.color = tokens.size() == others + 3 ? 3 : 4;
  const auto color = tokens.begin() + (n ? 3 : 0);
  layout.color_bytes = std::all_of(color, color + layout.color, [](std::string_view token) {
    return std::all_of(token.begin(), token.end(), IsDigit);
  });
  return layout;
}

std::vector<MeshAttribute> OffLayout::Attributes() const {
  std::vector<MeshAttribute> attributes;
  if (color > 0) {
    MeshAttribute attribute = OfVertices("color", color, Semantic::kColor);
    attribute.color_space = ColorSpace::kSrgb;
    if (color_bytes) attribute.type = ScalarType::kUint8;
    attribute.normalized = color_bytes;
    attributes.push_back(attribute);
  }
  if (normal) attributes.push_back(OfVertices("vertex_normal", 3, Semantic::kNormal));
  if (uv) attributes.push_back(OfVertices("uv", 2, Semantic::kUv));
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
  auto faces = std::make_unique<OffFaces>(source, max_line_bytes);
  if (auto begun = faces->Begin(places); !begun) return Forward(begun);
  mesh.faces = std::move(faces);
  std::vector<AttributeSource> sources;
  for (const MeshAttribute& attribute : wanted) sources.push_back(SourceOf(attribute));
  return PassOver(std::move(mesh), {wanted.begin(), wanted.end()}, std::move(sources), context);
}

}  // namespace strata::io
