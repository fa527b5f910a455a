#include "io/drc_reader.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "io/draco_mesh.h"
#include "io/face_assembler.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

class DrcReader : public MeshReader {
 public:
  DrcReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)), options_(options), vertices_(*source_, options) {
    info_ = {"drc", "draco", source_->compression()};
  }

  Result<void> Load() {
    const std::string& name = source_->name();
    const std::uint64_t size = source_->size().value_or(0);
    MemoryShare share;
    if (options_.memory != nullptr) {
      auto taken = options_.memory->Take(size, name + ": the Draco data");
      if (!taken) return Forward(taken);
      share = std::move(*taken);
    }
    std::string bytes(static_cast<std::size_t>(size), '\0');
    if (auto ok = source_->ReadAt(0, bytes); !ok) return ok;
    auto mesh = DracoMesh::Decode(bytes, name, options_.memory);
    if (!mesh) return Forward(mesh);
    if (auto ok = mesh->AppendPositions(std::nullopt, name, vertices_); !ok) return ok;
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

  Result<void> Rewind() override {
    faces_.Restart();
    next_ = 0;
    if (vertices_.far() != nullptr) vertices_.far()->Rewind();
    return {};
  }

 private:
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
