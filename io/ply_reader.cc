#include "io/ply_reader.h"

#include <algorithm>
#include <new>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/ply_attributes.h"
#include "io/ply_rows.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

constexpr std::size_t kWindowBytes = std::size_t{1} << 18;

tl::unexpected<Error> OutOfMemory(const ByteSource& source) {
  return Fail(ErrorCode::kOverBudget, source.name() + ": the vertices do not fit into memory");
}

class PlyReader : public MeshReader {
 public:
  PlyReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)), input_(*source_, kWindowBytes), vertices_(*source_, options) {}

  Result<void> Open(const OpenOptions& options) {
    auto header = ReadPlyHeader(input_, options.max_line_bytes);
    if (!header) return Forward(header);
    header_ = std::move(*header);
    info_ = {"ply", PlyEncodingName(header_.encoding), source_->compression()};
    const bool ascii = header_.encoding == PlyEncoding::kAscii;
    rows_ = ascii ? AsciiPlyRows(input_, header_) : BinaryPlyRows(input_, header_);
    if (auto ok = FindSurfaces(); !ok) return ok;
    if (auto ok = ReadVertices(); !ok) return ok;
    return FindAttributes();
  }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return vertices_.view(); }
  Result<bool> VisitVertices(const std::function<void(const VertexView&)>& visit) override {
    return vertices_.Visit(visit);
  }
  const ReadCounts& counts() const override { return faces_.counts(); }
  std::uint64_t bytes_read() const override { return source_->stored_position(); }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }

  bool SelectShare(const Share& share) override {
    const bool can = share.whole() || HasTriangleSize();
    share_ = can ? share : Share{};
    rows_->SelectShare(share_);
    faces_.CountVertices(share_.index == 0);
    return can;
  }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    try {
      return ReadBatch(
          faces_, batch, [this](FaceAssembler& faces) { return Fill(faces); },
          [this](FarVertices& far) { return LookAhead(far); });
    } catch (const std::bad_alloc&) {
      return Fail(ErrorCode::kOverBudget, source_->name() + ": a face does not fit into memory");
    }
  }

  std::span<const MeshAttribute> attributes() const override { return attributes_; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    std::vector<const PlyAttribute*> wanted;
    for (const std::size_t n : numbers) wanted.push_back(&carried_[n]);
    input_.Forget();
    return WithinMemory(source_->name() + ": the vertices' attributes do not fit into memory", [&] {
      return OpenPlyAttributes(*source_, header_, places_, wanted, context);
    });
  }

  Result<void> Rewind() override {
    faces_.Restart();
    in_surface_ = false;
    element_ = first_;
    if (vertices_.far() != nullptr) vertices_.far()->Rewind();
    return rows_->Seek(first_mark_);
  }

 private:
  // Whether the file's size is to the byte that of one whose only surface is triangles, which gives
  // every row a place. A mixture of other polygons may have that size too; but then all rows before
  // its first one that is no triangle are in their places, and so is that row: the share that holds
  // it refuses it. So if no share does, all rows are triangles.
  bool HasTriangleSize() const {
    const auto size = source_->size();
    if (!size || info_.compression != "none" || first_ == surfaces_.size()) return false;
    const PlySurface& surface = surfaces_[first_].what;
    const auto& properties = surface.element->properties;
    const auto lists = std::count_if(properties.begin(), properties.end(),
                                     [](const PlyProperty& p) { return p.is_list; });
    if (surface.strips || lists != 1) return false;
    std::uint64_t end = first_mark_.offset;
    for (std::size_t e = first_; e < header_.elements.size(); ++e) {
      const auto bytes = rows_->BytesOf(header_.elements[e], 3);
      if ((e > first_ && !IsPlain(e)) || !bytes) return false;
      if (__builtin_add_overflow(end, *bytes, &end)) return false;
    }
    return end == *size;
  }
  // Whether element `e` is no surface and, having no lists, has rows of one size.
  bool IsPlain(std::size_t e) const {
    const auto& properties = header_.elements[e].properties;
    return !surfaces_[e].wanted && std::none_of(properties.begin(), properties.end(),
                                                [](const PlyProperty& p) { return p.is_list; });
  }

  // What is known of an element besides its declaration.
  struct Surface {
    bool wanted = false;
    PlySurface what;
  };

  tl::unexpected<Error> HeaderError(const std::string& what,
                                    ErrorCode code = ErrorCode::kCorruptInput) const {
    return Fail(code, source_->name() + ": header: " + what);
  }

  // The only property called `name` or `or_name`, which `element` must have.
  Result<std::size_t> Require(const PlyElement& element, std::string_view name,
                              std::string_view or_name = {}) const {
    const auto found = element.Find(name, or_name);
    if (!found) {
      return HeaderError("element '" + element.name + "' has no property '" + std::string(name) +
                         "'");
    }
    for (std::size_t i = *found + 1; i < element.properties.size(); ++i) {
      const std::string& other = element.properties[i].name;
      if (other == name || (!or_name.empty() && other == or_name)) {
        return HeaderError("element '" + element.name + "' has '" + std::string(name) + "' twice");
      }
    }
    return *found;
  }

  Result<void> FindSurfaces() {
    surfaces_.resize(header_.elements.size());
    for (std::size_t e = 0; e < header_.elements.size(); ++e) {
      const PlyElement& element = header_.elements[e];
      const bool strips = element.name == "tristrips";
      if ((element.name != "face" && !strips) || element.count == 0) continue;
      auto indices = Require(element, "vertex_indices", "vertex_index");
      if (!indices) return Forward(indices);
      const PlyProperty& property = element.properties[*indices];
      if (!property.is_list || !IsInteger(property.type)) {
        return HeaderError(
            "'" + property.name + "' of '" + element.name + "' is not a list of integers",
            ErrorCode::kUnsupported);
      }
      surfaces_[e] = {true, {&element, *indices, strips}};
    }
    return {};
  }

  // Leaves the rows at the first surface, or at what comes after the vertices if there is none.
  Result<void> ReadVertices() {
    std::optional<std::size_t> first;
    std::size_t e = 0;
    for (; e < header_.elements.size(); ++e) {
      if (!first && surfaces_[e].wanted) first = e, first_mark_ = rows_->mark();
      if (header_.elements[e].name == "vertex") break;
      // Without vertices there is no reason to look beyond the first surface.
      if (first && header_.Find("vertex") == nullptr) break;
      if (auto ok = rows_->Skip(header_.elements[e]); !ok) return ok;
    }
    if (e < header_.elements.size() && header_.elements[e].name == "vertex") {
      places_.vertices_mark = rows_->mark();
      if (auto ok = LoadVertices(header_.elements[e]); !ok) return ok;
      vertex_element_ = e;
      after_vertices_ = rows_->mark();
      ++e;
    }
    if (auto ok = vertices_.Finish(); !ok) return ok;
    faces_.SetVertices(vertices_);
    if (!first) {
      for (; e < header_.elements.size() && !surfaces_[e].wanted; ++e) {
        if (auto ok = rows_->Skip(header_.elements[e]); !ok) return ok;
      }
      first = e;
      first_mark_ = rows_->mark();
    }
    first_ = element_ = *first;
    return rows_->Seek(first_mark_);
  }

  Result<void> FindAttributes() {
    places_.faces = first_;
    places_.faces_mark = first_mark_;
    places_.vertices = vertex_element_;
    auto found = FindPlyAttributes(*source_, header_, places_);
    if (!found) return Forward(found);
    carried_ = std::move(*found);
    for (const PlyAttribute& attribute : carried_) attributes_.push_back(attribute.what);
    if (!LooksAtRows(header_, places_)) return {};
    input_.Forget();
    return rows_->Seek(first_mark_);
  }

  Result<void> LoadVertices(const PlyElement& element) {
    if (element.count == 0) return {};
    std::size_t xyz[3];
    for (int a = 0; a < 3; ++a) {
      auto found = Require(element, std::string_view("xyz").substr(a, 1));
      if (!found) return Forward(found);
      if (element.properties[*found].is_list) {
        return HeaderError(std::string("'") + "xyz"[a] + "' is a list, expected a number");
      }
      xyz[a] = *found;
    }
    try {
      return rows_->ReadVertices(element, xyz, vertices_);
    } catch (const std::bad_alloc&) {
      return OutOfMemory(*source_);
    }
  }

  // Fills the batch from the present element and those after it.
  Result<void> Fill(FaceAssembler& faces) {
    while (!faces.full()) {
      if (element_ == header_.elements.size()) {
        return share_.count > 1 ? Result<void>() : rows_->CheckEnd();
      }
      auto done = surfaces_[element_].wanted ? ReadSurface(faces) : PassOver();
      if (!done) return Forward(done);
      if (*done) ++element_;
      // The rest was measured when the share was selected.
      if (*done && share_.count > 1) element_ = header_.elements.size();
    }
    return {};
  }

  // These two: true when the present element is used up.
  Result<bool> ReadSurface(FaceAssembler& faces) {
    if (!in_surface_) rows_->BeginSurface(surfaces_[element_].what);
    auto done = rows_->ReadSurface(faces);
    in_surface_ = done && !*done;
    return done;
  }
  Result<bool> PassOver() {
    const auto ok = element_ == vertex_element_ ? rows_->Seek(after_vertices_)
                                                : rows_->Skip(header_.elements[element_]);
    if (!ok) return Forward(ok);
    return true;
  }

  Result<void> LookAhead(FarVertices& far) {
    const std::size_t element = element_;
    const bool in_surface = in_surface_;
    const PlyProgress progress = rows_->progress();
    FaceAssembler scout = faces_.Scout();
    const auto go_on = [&]() -> Result<bool> {
      if (auto ok = Fill(scout); !ok) return Forward(ok);
      return element_ == header_.elements.size();
    };
    const auto go_back = [&] {
      element_ = element;
      in_surface_ = in_surface;
      if (in_surface) rows_->BeginSurface(surfaces_[element].what);
      return rows_->Resume(progress);
    };
    return far.LookAhead(go_on, go_back);
  }

  std::unique_ptr<ByteSource> source_;
  InputBuffer input_;
  MeshInfo info_;
  PlyHeader header_;
  std::vector<Surface> surfaces_;  // One for each element.
  std::unique_ptr<PlyRows> rows_;
  VertexStore vertices_;
  FaceAssembler faces_;
  PlyPlaces places_;
  std::vector<PlyAttribute> carried_;
  std::vector<MeshAttribute> attributes_;  // Of each, what it is.

  std::optional<std::size_t> vertex_element_;
  PlyMark after_vertices_;
  std::size_t first_ = 0;  // The first surface, or the end of the elements.
  PlyMark first_mark_;
  std::size_t element_ = 0;  // The one being read.
  bool in_surface_ = false;
  Share share_;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenPly(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options) {
  try {
    auto reader = std::make_unique<PlyReader>(std::move(source), options);
    if (auto ok = reader->Open(options); !ok) return Forward(ok);
    return reader;
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, "out of memory while opening a PLY file");
  }
}

}  // namespace strata::io
