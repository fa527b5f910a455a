#include "io/off_reader.h"

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "io/decimal.h"
#include "io/face_assembler.h"
#include "io/index_token.h"
#include "io/off_attributes.h"
#include "io/quote.h"
#include "io/text_scanner.h"
#include "io/vertex_store.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

constexpr std::int64_t kMaxCount = std::int64_t{1} << 62;

// What an OFF keyword's prefixes say that matters here.
struct Keyword {
  std::size_t length = 0;                          // Of the keyword in the text.
  bool st = false, color = false, normal = false;  // What vertices carry.
  bool four = false;  // Vertices have a fourth, homogeneous coordinate.
  bool n = false;     // Vertices have as many coordinates as the header says.
};

// The keyword at the start of `text`, its prefixes in any order and each at most once.
std::optional<Keyword> ParseKeyword(std::string_view text) {
  Keyword keyword;
  const auto take = [&](std::string_view prefix, bool& seen) {
    if (seen || text.substr(keyword.length, prefix.size()) != prefix) return false;
    keyword.length += prefix.size();
    return seen = true;
  };
  while (take("ST", keyword.st) || take("C", keyword.color) || take("N", keyword.normal) ||
         take("4", keyword.four) || take("n", keyword.n)) {
  }
  if (text.substr(keyword.length, 3) != "OFF") return std::nullopt;
  keyword.length += 3;
  return keyword;
}

class OffReader : public MeshReader {
 public:
  OffReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)),
        info_{"off", "ascii", source_->compression()},
        max_line_bytes_(options.max_line_bytes),
        text_(*source_, options.max_line_bytes),
        vertices_(*source_, options) {}

  // Everything before the faces.
  Result<void> Load() {
    if (!ParseHeader()) return text_.failure();
    places_.vertices_offset = text_.next_offset();
    places_.vertices_line = text_.next_line_number();
    for (std::int64_t i = 0; i < vertex_count_; ++i) {
      if (!ParseVertex(i)) return vertices_.failed() ? vertices_.failure() : text_.failure();
    }
    faces_offset_ = text_.next_offset();
    faces_line_ = text_.next_line_number();
    places_.vertices = vertex_count_;
    places_.faces = face_count_;
    places_.faces_offset = faces_offset_;
    places_.faces_line = faces_line_;
    PeekAtFaces();
    attributes_ = layout_.Attributes();
    if (auto ok = vertices_.Finish(); !ok) return ok;
    faces_.SetVertices(vertices_);
    return {};
  }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return vertices_.view(); }
  Result<bool> VisitVertices(const std::function<void(const VertexView&)>& visit) override {
    return vertices_.Visit(visit);
  }
  const ReadCounts& counts() const override { return faces_.counts(); }
  std::uint64_t bytes_read() const override { return source_->stored_position(); }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    return ReadBatch(
        faces_, batch, [this](FaceAssembler& faces) { return Fill(faces); },
        [this](FarVertices& far) { return LookAhead(far); });
  }

  std::span<const MeshAttribute> attributes() const override { return attributes_; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    std::vector<MeshAttribute> wanted;
    for (const std::size_t n : numbers) wanted.push_back(attributes_[n]);
    text_.Forget();
    return WithinMemory(source_->name() + ": the vertices' attributes do not fit into memory", [&] {
      return OpenOffAttributes(*source_, max_line_bytes_, layout_, places_, wanted, context);
    });
  }

  Result<void> Rewind() override {
    faces_.Restart();
    faces_read_ = 0;
    ended_ = held_ = false;
    if (vertices_.far() != nullptr) vertices_.far()->Rewind();
    return text_.Seek(faces_offset_, faces_line_);
  }

 private:
  Result<void> Fill(FaceAssembler& faces) {
    while (!faces.full() && faces_read_ < face_count_ && ParseFace(faces)) {
    }
    if (!text_.failed() && !faces.full() && !ended_) CheckEnd();
    return text_.failed() ? Result<void>(text_.failure()) : Result<void>();
  }

  Result<void> LookAhead(FarVertices& far) {
    const std::uint64_t offset = held_ ? faces_offset_ : text_.next_offset();
    const std::uint64_t line = held_ ? faces_line_ : text_.next_line_number();
    const std::int64_t faces_read = faces_read_;
    const bool ended = ended_;
    FaceAssembler scout = faces_.Scout();
    const auto go_on = [&]() -> Result<bool> {
      if (auto ok = Fill(scout); !ok) return Forward(ok);
      return faces_read_ == face_count_;
    };
    const auto go_back = [&] {
      faces_read_ = faces_read;
      ended_ = ended;
      return text_.Seek(offset, line);
    };
    return far.LookAhead(go_on, go_back);
  }

  // Goes to the next line that has something besides a comment, between p_ and last_. False at the
  // end or on an error.
  bool NextLine() {
    if (std::exchange(held_, false)) return true;
    while (text_.Next()) {
      std::string_view line = text_.line();
      p_ = SkipBlanks(line.data(), line.data() + line.size());
      last_ = line.data() + line.size();
      if (p_ < last_ && *p_ != '#') return true;
    }
    return false;
  }
  // Looks at the first face for what it carries, and holds its line back for whoever reads it. That
  // there is none is theirs to say.
  void PeekAtFaces() {
    if (face_count_ == 0 || !NextLine()) return;
    layout_.AddFaces({p_, static_cast<std::size_t>(last_ - p_)});
    held_ = true;
  }
  bool AtEndOfLine() {
    p_ = SkipBlanks(p_, last_);
    return p_ == last_ || *p_ == '#';
  }
  // True if a number that ends at `end` ends there indeed.
  bool IsDelimited(const char* end) const {
    return end != nullptr && (end == last_ || IsBlank(*end) || *end == '#');
  }
  bool RejectToken(const std::string& expected) {
    if (!AtEndOfLine())
      return text_.Reject("found " + Quoted(TokenAt(p_, last_)) + ", expected " + expected);
    return text_.Reject("found the end of the " +
                        std::string(text_.terminated() ? "line" : "file") + ", expected " +
                        expected);
  }
  // An error, unless there was one already: the text ended too early.
  bool RejectEnd(const std::string& expected) {
    return !text_.failed() && text_.Reject("found the end of the file, expected " + expected);
  }

  bool ParseInteger(std::int64_t& value, const std::string& expected) {
    if (AtEndOfLine()) return RejectToken(expected);
    const char* const end = ParseIndex(p_, last_, value);
    if (!IsDelimited(end)) return RejectToken(expected);
    p_ = end;
    return true;
  }

  bool ParseHeader() {
    if (!NextLine()) return RejectEnd("an OFF header");
    const std::string_view rest(p_, static_cast<std::size_t>(last_ - p_));
    const std::optional<Keyword> keyword = ParseKeyword(rest);
    if (keyword) {
      keyword_ = *keyword;
      p_ += keyword->length;
      const std::string found(rest.substr(0, keyword->length));
      if (keyword->four || keyword->n) return RejectKind(found);
      if (AtEndOfLine()) {
        if (!NextLine()) return RejectEnd("the numbers of vertices and faces");
      }
      if (TokenAt(p_, last_) == "BINARY") return RejectKind(found + " BINARY");
    } else if (!IsDigit(*p_)) {
      return RejectToken("an OFF header");
    }
    return ParseCount(vertex_count_, "vertices") && ParseCount(face_count_, "faces");
  }

  bool RejectKind(const std::string& found) {
    return text_.Reject("found " + found +
                            ", which is not supported; expected OFF in three "
                            "dimensions and in text form (OFF, COFF, NOFF, STOFF or a mixture)",
                        ErrorCode::kUnsupported);
  }

  bool ParseCount(std::int64_t& count, const std::string& of_what) {
    const std::string expected = "the number of " + of_what;
    AtEndOfLine();
    const char* const start = p_;
    if (!ParseInteger(count, expected)) return false;
    if (count >= 0 && count < kMaxCount) return true;
    p_ = start;
    return RejectToken(expected);
  }

  bool ParseVertex(std::int64_t i) {
    if (!NextLine()) {
      return RejectEnd(std::to_string(vertex_count_) + " vertices, of which there were " +
                       std::to_string(i));
    }
    double xyz[3];
    for (int axis = 0; axis < 3; ++axis) {
      p_ = SkipBlanks(p_, last_);
      const char* const end = ParseDecimal(p_, last_, xyz[axis]);
      if (!IsDelimited(end)) {
        return RejectToken("a number as the vertex's " + std::string(1, "xyz"[axis]));
      }
      p_ = end;
    }
    if (i == 0) {
      layout_ = OffLayout::Of(keyword_.normal, keyword_.color, keyword_.st,
                              {p_, static_cast<std::size_t>(last_ - p_)});
    }
    return vertices_.Append(xyz[0], xyz[1], xyz[2]);
  }

  bool ParseFace(FaceAssembler& faces) {
    if (!NextLine()) {
      return RejectEnd(std::to_string(face_count_) + " faces, of which there were " +
                       std::to_string(faces_read_));
    }
    std::int64_t n = 0;
    const char* const start = p_;
    if (!ParseInteger(n, "the number of the face's corners")) return false;
    if (n < 0) {
      p_ = start;
      return RejectToken("the number of the face's corners");
    }
    corners_.clear();
    for (std::int64_t k = 0; k < n; ++k) {
      p_ = SkipBlanks(p_, last_);
      std::int64_t index = 0;
      const char* const end = ParseIndex(p_, last_, index);
      if (!IsDelimited(end)) return RejectCorner(k, n);
      p_ = end;
      corners_.push_back(index);
    }
    faces.AddFace(corners_);
    ++faces_read_;
    return true;
  }

  bool RejectCorner(std::int64_t k, std::int64_t n) {
    return RejectToken("corner " + std::to_string(k + 1) + " of " + std::to_string(n));
  }

  // Behind the last face: more than the header declared contradicts it as much as less.
  bool CheckEnd() {
    ended_ = true;
    if (!NextLine()) return !text_.failed();
    return RejectToken("nothing more, as the header says " + std::to_string(face_count_) +
                       " faces");
  }

  std::unique_ptr<ByteSource> source_;
  MeshInfo info_;
  const std::size_t max_line_bytes_;
  TextScanner text_;
  VertexStore vertices_;
  FaceAssembler faces_;
  std::int64_t vertex_count_ = 0, face_count_ = 0, faces_read_ = 0;
  std::uint64_t faces_offset_ = 0, faces_line_ = 1;
  bool ended_ = false, held_ = false;  // Whether NextLine has still to give the present line.
  Keyword keyword_;
  OffLayout layout_;
  OffPlaces places_;
  std::vector<MeshAttribute> attributes_;
  const char* p_ = nullptr;  // What is left of the line.
  const char* last_ = nullptr;
  std::vector<std::int64_t> corners_;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenOff(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options) {
  return WithinMemory(source->name() + ": the vertices do not fit into memory",
                      [&] { return MakeLoaded<OffReader>(std::move(source), options); });
}

}  // namespace strata::io
