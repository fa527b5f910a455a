#include "io/assimp_reader.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "io/assimp_child.h"
#include "io/assimp_records.h"
#include "io/detect_format.h"
#include "io/triangulate.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

constexpr std::uint64_t kMostMemory = std::uint64_t{8} << 30;
constexpr std::size_t kFewestCorners = 3;

// A child and what it says.
struct AssimpRun {
  AssimpRun(const std::string& name, const AssimpOrder& order, const RunContext* context)
      : child(name, context), records(name, child, order.attributes) {}
  AssimpChild child;
  AssimpRecords records;

  Result<AssimpHead> Start(const AssimpOrder& order) {
    if (auto started = child.Start(order); !started) return Forward(started);
    return records.Head();
  }
};

class AssimpPass final : public AttributePass {
 public:
  AssimpPass(std::string name, std::unique_ptr<AssimpRun> run, AssimpColumns wanted,
             std::size_t width)
      : name_(std::move(name)), run_(std::move(run)), wanted_(std::move(wanted)), width_(width) {}

  Result<void> Read(std::span<const SurfacePoint> points, std::span<char* const> out) override {
    for (std::size_t i = 0; i < points.size(); ++i) {
      while (points[i].triangle >= next_) {
        if (auto ok = Advance(); !ok) return ok;
      }
      const auto piece = static_cast<std::size_t>(points[i].triangle - first_);
      if (piece >= pieces_.size()) return Absent();
      for (std::size_t k = 0; k < wanted_.attributes.size(); ++k) {
        Put(k, pieces_[piece], points[i].weight, out[k] + i * wanted_.attributes[k].bytes());
      }
    }
    return {};
  }

 private:
  tl::unexpected<Error> Absent() const {
    return Fail(ErrorCode::kCorruptInput,
                name_ + ": a triangle is not there any more; did the file change meanwhile?");
  }

  Result<void> Advance() {
    const auto more = run_->records.Next(polygon_);
    if (!more) return Forward(more);
    if (!*more) return Absent();
    pieces_.clear();
    TriangulatePolygon(polygon_.corners, pieces_);
    first_ = next_;
    // As the reader numbers them.
    next_ += polygon_.corners.size() < kFewestCorners ? 1 : pieces_.size();
    return {};
  }

  void Put(std::size_t k, const std::array<std::uint32_t, 3>& piece,
           const std::array<double, 3>& weight, char* out) const {
    const MeshAttribute& attribute = wanted_.attributes[k];
    const std::size_t offset = wanted_.offsets[k];
    if (attribute.carry == Carry::kConstant) {
      std::memcpy(out, &polygon_.ids[offset], sizeof(std::uint32_t));
      return;
    }
    std::array<const char*, 3> corner{};
    for (std::size_t v = 0; v < 3; ++v) {
      corner[v] =
          reinterpret_cast<const char*>(polygon_.values.data() + piece[v] * width_ + offset);
    }
    CarryValue(attribute, corner, weight, out);
  }

  const std::string name_;
  const std::unique_ptr<AssimpRun> run_;
  const AssimpColumns wanted_;
  const std::size_t width_;
  AssimpPolygon polygon_;
  std::vector<std::array<std::uint32_t, 3>> pieces_;
  std::uint64_t first_ = 0, next_ = 0;  // The triangles of polygon_.
};

class AssimpReader : public MeshReader {
 public:
  AssimpReader(std::unique_ptr<ByteSource> source, const OpenOptions& options)
      : source_(std::move(source)), options_(options) {
    info_ = {"assimp", "converted", source_->compression()};
  }

  Result<void> Load() {
    if (auto ok = Copy(); !ok) return ok;
    memory_ = kMostMemory;
    if (options_.memory != nullptr && options_.memory->limited()) {
      memory_ = std::min(memory_, options_.memory->left() / 2);
      auto share = options_.memory->Take(memory_, source_->name() + ": the process that reads it");
      if (!share) return Forward(share);
      share_ = std::move(*share);
    }
    return Rewind();
  }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return {}; }
  const ReadCounts& counts() const override { return counts_; }
  std::uint64_t bytes_read() const override {
    return ended_ ? source_->stored_size().value_or(0) : 0;
  }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    batch.Clear();
    for (Drain(batch); !batch.full() && !ended_; Drain(batch)) {
      const auto more = run_->records.Next(polygon_);
      if (!more) return Forward(more);
      ended_ = !*more;
      if (*more) Cut();
    }
    return batch.size();
  }

  Result<void> Rewind() override {
    pieces_.clear();
    next_piece_ = 0;
    counts_.faces = counts_.triangles = 0;
    counts_.skipped = {};
    ended_ = false;
    auto run = StartRun(false, options_.context);
    if (!run) return Forward(run);
    run_ = std::move(*run);
    return {};
  }

  std::span<const MeshAttribute> attributes() const override { return columns_.attributes; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    AssimpColumns wanted;
    for (const std::size_t n : numbers) {
      wanted.attributes.push_back(columns_.attributes[n]);
      wanted.offsets.push_back(columns_.offsets[n]);
    }
    auto run = StartRun(true, &context);
    if (!run) return Forward(run);
    return std::make_unique<AssimpPass>(source_->name(), std::move(*run), std::move(wanted),
                                        width_);
  }

 private:
  // The child is given a file of its own, whatever the source is.
  Result<void> Copy() {
    auto file = NewScratchFile(options_.scratch);
    if (!file) return Forward(file);
    copy_ = std::move(*file);
    std::vector<char> buffer(std::size_t{1} << 18);
    for (;;) {
      const auto n = source_->Read(buffer);
      if (!n) return Forward(n);
      if (*n == 0) return {};
      if (auto ok = copy_->Append({buffer.data(), *n}); !ok) return ok;
    }
  }

  // Starts a child in place of the one there is, and takes in what it says first.
  Result<std::unique_ptr<AssimpRun>> StartRun(bool attributes, const RunContext* context) {
    run_.reset();
    const AssimpOrder order{options_.assimp, copy_->descriptor(), memory_,
                            MeshSuffix(source_->name()), attributes};
    auto run = std::make_unique<AssimpRun>(source_->name(), order, context);
    auto head = run->Start(order);
    if (!head) return Forward(head);
    if (!opened_) Describe(*head);
    opened_ = true;
    if (head->width() != width_) {
      return Fail(ErrorCode::kCorruptInput,
                  source_->name() + ": what its corners carry changed meanwhile");
    }
    return run;
  }

  void Describe(const AssimpHead& head) {
    width_ = head.width();
    counts_.vertices = head.vertices;
    info_.format = "assimp:" + head.format;
    MeshContents& contents = info_.contents;
    contents.meshes = head.meshes;
    contents.instances = head.placings;
    if (head.points > 0) contents.passed_over.emplace_back("points", head.points);
    if (head.lines > 0) contents.passed_over.emplace_back("lines", head.lines);
    contents.materials = head.material_names;
    contents.up_axis = head.up_axis;
    columns_ = ListAssimpColumns(head);
  }

  void Cut() {
    pieces_.clear();
    next_piece_ = 0;
    ++counts_.faces;
    if (polygon_.corners.size() < kFewestCorners) {
      ++counts_.triangles;
      ++counts_.skipped[static_cast<std::size_t>(SkipReason::kTooFewCorners)];
      return;
    }
    TriangulatePolygon(polygon_.corners, pieces_);
  }

  void Drain(TriangleBatch& batch) {
    for (; next_piece_ < pieces_.size() && !batch.full(); ++next_piece_) {
      const auto& [a, b, c] = pieces_[next_piece_];
      const std::vector<Vec3>& corners = polygon_.corners;
      batch.Push(corners[a], corners[b], corners[c], counts_.triangles++);
    }
  }

  std::unique_ptr<ByteSource> source_;
  const OpenOptions options_;
  MeshInfo info_;
  std::unique_ptr<ScratchFile> copy_;
  std::uint64_t memory_ = 0;
  MemoryShare share_;
  std::unique_ptr<AssimpRun> run_;
  ReadCounts counts_;
  AssimpColumns columns_;
  std::size_t width_ = 0;
  bool opened_ = false, ended_ = false;
  AssimpPolygon polygon_;
  std::vector<std::array<std::uint32_t, 3>> pieces_;
  std::size_t next_piece_ = 0;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenAssimp(std::unique_ptr<ByteSource> source,
                                               const OpenOptions& options) {
  return WithinMemory(source->name() + ": the mesh does not fit into memory",
                      [&] { return MakeLoaded<AssimpReader>(std::move(source), options); });
}

}  // namespace strata::io
