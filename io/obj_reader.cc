#include "io/obj_reader.h"

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "io/decimal.h"
#include "io/face_assembler.h"
#include "io/index_token.h"
#include "io/obj_attributes.h"
#include "io/obj_materials.h"
#include "io/quote.h"
#include "io/text_scanner.h"
#include "io/vertex_store.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

using Statement = ObjStatement::Kind;

class ObjReader : public MeshReader {
 public:
  ObjReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)),
        info_{"obj", "ascii", source_->compression()},
        options_(options),
        max_line_bytes_(options.max_line_bytes),
        text_(*source_, options.max_line_bytes),
        vertices_(*source_, options) {}

  // The first pass.
  Result<void> Load() {
    while (NextStatement()) {
      contents_.Note({statement_, rest_view_});
      if (statement_ == Statement::kFace) NoteFace();
      if (statement_ == Statement::kVertex && !ParseVertex()) return LoadFailure();
      if (statement_ == Statement::kOther) NoteLibrary();
    }
    if (text_.failed()) return text_.failure();
    if (auto ok = vertices_.Finish(); !ok) return ok;
    faces_.SetVertices(vertices_);
    if (auto ok = materials_.Load(source_->name(), options_); !ok) return ok;
    materials_.Describe(info_.contents);
    attributes_ = contents_.Attributes();
    colors_ = materials_.ColorsOf(contents_.MaterialNames(), source_->name(), options_);
    if (colors_.textured()) attributes_.push_back(TextureAttribute(true));
    return Rewind();
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
      return OpenObjAttributes(*source_, max_line_bytes_, contents_, colors_, wanted, context);
    });
  }
  Result<void> CheckAttribute(std::size_t number, CheckDepth depth, RunContext& context) override {
    if (attributes_[number].carry != Carry::kLookedUp) return {};
    return CheckTextures(*colors_.images, colors_.materials, depth, context);
  }
  std::vector<MeshTexture> InspectTextures(RunContext& context) override {
    // Of all materials, used or not: what the file says it has.
    std::vector<std::string> names;
    for (const ObjMaterial& material : materials_.materials()) names.push_back(material.name);
    const ObjColors all = materials_.ColorsOf(names, source_->name(), options_);
    std::vector<MeshTexture> textures;
    for (const std::string& path : all.images->paths()) {
      MeshTexture& texture = textures.emplace_back();
      const auto number = static_cast<std::uint32_t>(textures.size() - 1);
      texture.place = path;
      Inspect(*all.images, number, &context.memory(), texture);
      for (std::uint32_t k = 0; k < all.materials.size(); ++k) {
        if (all.materials[k].image == number) texture.materials.push_back(k);
      }
    }
    return textures;
  }

  Result<void> Rewind() override {
    faces_.Restart();
    vertices_before_ = extent_.vertices_before;
    if (vertices_.far() != nullptr) vertices_.far()->Rewind();
    return text_.Seek(extent_.begin, extent_.line);
  }

 private:
  // The part of the text between the first face and the last.
  struct Extent {
    std::uint64_t begin = 0, end = 0, line = 1, vertices_before = 0;
  };

  tl::unexpected<Error> LoadFailure() const {
    return vertices_.failed() ? vertices_.failure() : text_.failure();
  }

  Result<void> Fill(FaceAssembler& faces) {
    while (!faces.full() && text_.next_offset() < extent_.end && NextStatement()) {
      if (statement_ == Statement::kVertex) ++vertices_before_;
      if (statement_ == Statement::kFace && !ParseFace(faces)) break;
    }
    return text_.failed() ? Result<void>(text_.failure()) : Result<void>();
  }

  Result<void> LookAhead(FarVertices& far) {
    const std::uint64_t offset = text_.next_offset(), line = text_.next_line_number();
    const std::uint64_t vertices_before = vertices_before_;
    FaceAssembler scout = faces_.Scout();
    const auto go_on = [&]() -> Result<bool> {
      if (auto ok = Fill(scout); !ok) return Forward(ok);
      return text_.next_offset() >= extent_.end;
    };
    const auto go_back = [&] {
      vertices_before_ = vertices_before;
      return text_.Seek(offset, line);
    };
    return far.LookAhead(go_on, go_back);
  }

  // Goes to the next statement; false at the end or on an error.
  bool NextStatement() {
    if (!text_.Next()) return false;
    if (!text_.JoinContinuations()) return false;
    const ObjStatement statement = ClassifyObj(text_.line());
    statement_ = statement.kind;
    rest_view_ = statement.rest;
    rest_ = rest_view_.data();
    return true;
  }

  const char* last() const { return text_.line().data() + text_.line().size(); }

  bool ParseVertex() {
    double xyz[3];
    const char* p = rest_;
    for (int axis = 0; axis < 3; ++axis) {
      p = SkipBlanks(p, last());
      const char* const end = ParseDecimal(p, last(), xyz[axis]);
      if (end == nullptr || (end < last() && !IsBlank(*end) && *end != '#')) {
        return RejectCoordinate(p, axis);
      }
      p = end;
    }
    return vertices_.Append(xyz[0], xyz[1], xyz[2]);
  }

  bool RejectCoordinate(const char* p, int axis) {
    const std::string expected = "expected a number as the vertex's " + std::string(1, "xyz"[axis]);
    if (p < last() && *p != '#')
      return text_.Reject("found " + Quoted(TokenAt(p, last())) + ", " + expected);
    return text_.Reject(std::string("found the end of the ") +
                        (text_.terminated() ? "line, " : "file, ") + expected);
  }

  void NoteLibrary() {
    constexpr std::string_view kKeyword = "mtllib";
    const std::string_view line = text_.line();
    if (line.size() > kKeyword.size() && line.starts_with(kKeyword) &&
        IsBlank(line[kKeyword.size()])) {
      materials_.AddLibrary(line.substr(kKeyword.size()));
    }
  }

  void NoteFace() {
    if (extent_.end == 0) {
      extent_.begin = text_.line_offset();
      extent_.line = text_.line_number();
      extent_.vertices_before = vertices_.size();
    }
    extent_.end = text_.next_offset();
  }

  // From an index as written to one that counts from 0; what is out of range stays so.
  std::int64_t Resolve(std::int64_t index) const {
    if (index > 0) return index - 1;
    return index == 0 ? -1 : static_cast<std::int64_t>(vertices_before_) + index;
  }

  bool ParseFace(FaceAssembler& faces) {
    corners_.clear();
    const char* const end = last();
    for (const char* p = SkipBlanks(rest_, end); p < end && *p != '#'; p = SkipBlanks(p, end)) {
      std::int64_t index = 0;
      const char* const token = p;
      p = ParseIndex(p, end, index);
      // Texture and normal are not used: whatever numbers they are, in range or not, is as well.
      if (p != nullptr && p < end && *p == '/') {
        while (p < end && (*p == '/' || *p == '-' || *p == '+' || IsDigit(*p))) ++p;
      }
      if (p == nullptr || (p < end && !IsBlank(*p) && *p != '#')) {
        return text_.Reject("found " + Quoted(TokenAt(token, end)) +
                            ", expected a corner such as 1, 1/2, 1//3 or 1/2/3");
      }
      corners_.push_back(Resolve(index));
    }
    if (corners_.size() < 3 && !text_.terminated()) {
      return text_.Reject("found the end of the file after " + std::to_string(corners_.size()) +
                          " corners of a face, expected at least 3");
    }
    faces.AddFace(corners_);
    return true;
  }

  std::unique_ptr<ByteSource> source_;
  MeshInfo info_;
  const OpenOptions options_;
  ObjMaterials materials_;
  const std::size_t max_line_bytes_;
  TextScanner text_;
  VertexStore vertices_;
  FaceAssembler faces_;
  Extent extent_;
  std::uint64_t vertices_before_ = 0;  // Vertices before the line, in the second pass.
  Statement statement_ = Statement::kOther;
  std::string_view rest_view_;  // The line behind the keyword, …
  const char* rest_ = nullptr;  // … and where that begins.
  ObjContents contents_;
  ObjColors colors_;
  std::vector<MeshAttribute> attributes_;
  std::vector<std::int64_t> corners_;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenObj(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options) {
  return WithinMemory(source->name() + ": the vertices do not fit into memory",
                      [&] { return MakeLoaded<ObjReader>(std::move(source), options); });
}

}  // namespace strata::io
