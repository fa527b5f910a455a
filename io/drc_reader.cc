#include "io/drc_reader.h"

#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/draco_mesh.h"
#include "io/face_assembler.h"
#include "io/indexed_attributes.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

using Faces = std::vector<std::array<std::uint32_t, 3>>;

class DrcFaces final : public FaceWalker {
 public:
  explicit DrcFaces(const Faces& faces) : faces_(faces) {}
  Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) override {
    const auto& corners = faces_[static_cast<std::size_t>(triangle)];
    face.first = triangle;
    face.corners = 3;
    face.rows.assign(corners.begin(), corners.end());
    return {};
  }

 private:
  const Faces& faces_;
};

class DrcReader : public MeshReader {
 public:
  DrcReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)), options_(options), vertices_(*source_, options) {
    info_ = {"drc", "draco", source_->compression()};
  }

  Result<void> Load() {
    auto mesh = Decode();
    if (!mesh) return Forward(mesh);
    if (auto ok = mesh->AppendPositions(std::nullopt, source_->name(), vertices_); !ok) return ok;
    columns_ = mesh->Columns();
    if (columns_.too_wide > 0) {
      info_.contents.passed_over.emplace_back("attributes of too many components",
                                              columns_.too_wide);
    }
    mesh->Drop();
    mesh_ = std::move(*mesh);
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
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }
  std::uint64_t bytes_read() const override {
    const double part = mesh_->faces().empty() ? 1
                                               : static_cast<double>(next_) /
                                                     static_cast<double>(mesh_->faces().size());
    return static_cast<std::uint64_t>(part * static_cast<double>(bytes_total().value_or(0)));
  }

  bool SelectShare(const Share& share) override {
    share_ = share;
    faces_.CountVertices(share.index == 0);
    return true;
  }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    return ReadBatch(
        faces_, batch, [this](FaceAssembler& faces) { return Fill(faces); },
        [this](FarVertices& far) { return LookAhead(far); });
  }

  std::span<const MeshAttribute> attributes() const override { return columns_.attributes; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    return WithinMemory(source_->name() + ": the points' attributes do not fit into memory",
                        [&] { return OpenPass(numbers, context); });
  }

  Result<void> Rewind() override {
    faces_.Restart();
    next_ = 0;
    if (vertices_.far() != nullptr) vertices_.far()->Rewind();
    return {};
  }

 private:
  Result<DracoMesh> Decode() {
    const std::string& name = source_->name();
    const std::uint64_t size = source_->size().value_or(0);
    MemoryShare share;
    if (options_.memory != nullptr) {
      auto taken = options_.memory->Take(size, name + ": the Draco data");
      if (!taken) return Forward(taken);
      share = std::move(*taken);
    }
    std::string bytes(static_cast<std::size_t>(size), '\0');
    if (auto ok = source_->ReadAt(0, bytes); !ok) return Forward(ok);
    return DracoMesh::Decode(bytes, name, options_.memory);
  }

  // The data are decoded once more: between the two only faces and positions are kept.
  Result<std::unique_ptr<AttributePass>> OpenPass(std::span<const std::size_t> numbers,
                                                  RunContext& context) {
    std::vector<MeshAttribute> attributes;
    std::vector<AttributeSource> sources;
    std::vector<std::uint32_t> stored;
    std::size_t row_bytes = 0;
    for (const std::size_t n : numbers) {
      const MeshAttribute& attribute = attributes.emplace_back(columns_.attributes[n]);
      stored.push_back(columns_.numbers[n]);
      AttributeSource& source = sources.emplace_back();
      source.field.type = attribute.type;
      for (int k = 0; k < attribute.components; ++k) {
        source.field.offset.push_back(row_bytes);
        row_bytes += SizeOf(attribute.type);
      }
    }
    auto decoded = Decode();
    if (!decoded) return Forward(decoded);
    auto table = std::make_unique<RowTable>(row_bytes, context);
    if (auto ok = decoded->AppendRows(stored, source_->name(), *table); !ok) return Forward(ok);
    if (auto ok = table->Finish(); !ok) return Forward(ok);
    IndexedMesh mesh;
    mesh.name = source_->name();
    mesh.faces = std::make_unique<DrcFaces>(mesh_->faces());
    mesh.tables.push_back(std::move(table));
    return PassOver(std::move(mesh), std::move(attributes), std::move(sources), context);
  }

  Result<void> Fill(FaceAssembler& faces) {
    const std::uint64_t end = mesh_->faces().size();
    while (!faces.full()) {
      const std::uint64_t next = std::min(share_.Next(next_), end);
      faces.PassOver(next - std::exchange(next_, next));
      if (next_ == end) break;
      const auto& face = mesh_->faces()[static_cast<std::size_t>(next_++)];
      const std::int64_t corners[3] = {face[0], face[1], face[2]};
      faces.AddFace(corners);
    }
    return {};
  }

  Result<void> LookAhead(FarVertices& far) {
    const std::uint64_t next = next_;
    FaceAssembler scout = faces_.Scout();
    const auto go_on = [&]() -> Result<bool> {
      if (auto ok = Fill(scout); !ok) return Forward(ok);
      return next_ == mesh_->faces().size();
    };
    const auto go_back = [&]() -> Result<void> {
      next_ = next;
      return {};
    };
    return far.LookAhead(go_on, go_back);
  }

  std::unique_ptr<ByteSource> source_;
  const OpenOptions options_;
  MeshInfo info_;
  VertexStore vertices_;
  FaceAssembler faces_;
  std::optional<DracoMesh> mesh_;
  DracoColumns columns_;
  Share share_;
  std::uint64_t next_ = 0;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenDraco(std::unique_ptr<ByteSource> source,
                                              const OpenOptions& options) {
  using Opened = Result<std::unique_ptr<MeshReader>>;
  return WithinMemory(source->name() + ": the mesh does not fit into memory", [&]() -> Opened {
    auto readable = WithReadAt(std::move(source), options.scratch);
    if (!readable) return Forward(readable);
    return MakeLoaded<DrcReader>(std::move(*readable), options);
  });
}

}  // namespace strata::io
