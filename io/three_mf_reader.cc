#include "io/three_mf_reader.h"

#include <array>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/placed_reader.h"
#include "io/quote.h"
#include "io/three_mf_attributes.h"
#include "io/three_mf_package.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

constexpr int kMostDepth = 64;
constexpr std::uint64_t kMostPlacings = std::uint64_t{1} << 20;

// What the reader says of its input: the archive's own bytes.
class ArchiveSource : public ByteSource {
 public:
  explicit ArchiveSource(std::shared_ptr<ZipArchive> archive) : archive_(std::move(archive)) {}
  Result<std::size_t> Read(std::span<char>) override { return std::size_t{0}; }
  Result<void> Seek(std::uint64_t) override { return {}; }
  std::optional<std::uint64_t> size() const override { return archive_->size(); }
  std::uint64_t stored_position() const override { return archive_->size(); }
  std::optional<std::uint64_t> stored_size() const override { return archive_->size(); }
  std::string compression() const override { return "zip"; }
  const std::string& name() const override { return archive_->name(); }

 private:
  std::shared_ptr<ZipArchive> archive_;
};

class Geometry : public PlacedGeometry {
 public:
  explicit Geometry(std::shared_ptr<ThreeMfMesh> mesh) : mesh_(std::move(mesh)) {
    if (mesh_->vertices.far() != nullptr) mesh_->vertices.far()->Rewind();
  }
  const VertexStore& vertices() const override { return mesh_->vertices; }
  Result<std::span<const std::int64_t>> Corners(std::uint64_t number) override {
    const std::uint32_t* const from = mesh_->corners.data() + 3 * number;
    corners_ = {from[0], from[1], from[2]};
    return std::span<const std::int64_t>(corners_);
  }

 private:
  std::shared_ptr<ThreeMfMesh> mesh_;
  std::array<std::int64_t, 3> corners_{};
};

class ThreeMfReader : public PlacedReader {
 public:
  ThreeMfReader(std::shared_ptr<ZipArchive> archive, ThreeMfModel model)
      : PlacedReader(std::make_unique<ArchiveSource>(std::move(archive))),
        model_(std::move(model)) {
    info_ = {"3mf", "xml", "zip"};
  }

  Result<void> Load() {
    for (; item_ < model_.items.size(); ++item_) {
      if (auto ok = Visit(model_.items[item_], Affine(), 0); !ok) return ok;
    }
    MeshContents& contents = info_.contents;
    contents.meshes = 0;
    for (const auto& [key, object] : model_.objects) {
      if (object.mesh == nullptr) continue;
      ++*contents.meshes;
      vertex_count_ += object.mesh->vertices.size();
      if (auto ok = AddMesh(object, key); !ok) return ok;
    }
    contents.instances = placings_;
    contents.unit = model_.unit;
    contents.up_axis = "z";
    contents.materials = model_.materials;
    if (unplaced_ > 0) contents.passed_over.emplace_back("meshes outside the build", unplaced_);
    if (model_.other_groups > 0) {
      contents.passed_over.emplace_back("groups of textures or composites", model_.other_groups);
    }
    attributes_ = ListThreeMfAttributes(model_, objects_);
    return Rewind();
  }

  std::span<const MeshAttribute> attributes() const override { return attributes_; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    std::vector<MeshAttribute> wanted;
    for (const std::size_t n : numbers) wanted.push_back(attributes_[n]);
    const auto locate = [this](std::uint64_t triangle) -> ThreeMfPlace {
      const Location at = Locate(triangle);
      return {at.placement, at.triangle, items_[at.transform],
              transforms_[at.transform].Determinant() < 0};
    };
    return PassOverThreeMf(model_, objects_, std::move(wanted), locate, context);
  }

 protected:
  Result<std::shared_ptr<PlacedGeometry>> LoadGeometry(std::size_t placement) override {
    return std::make_shared<Geometry>(objects_[placement].object->mesh);
  }
  const Affine& TransformOf(std::size_t number) const override { return transforms_[number]; }

 private:
  using Key = std::pair<std::string, std::uint64_t>;

  Result<void> Visit(const ThreeMfObject::Component& at, const Affine& parent, int depth) {
    const auto found = model_.objects.find({at.part, at.object});
    if (found == model_.objects.end() || depth > kMostDepth) {
      return Fail(ErrorCode::kCorruptInput,
                  source().name() + ": object " + std::to_string(at.object) + " of " +
                      Quoted(at.part) +
                      (depth > kMostDepth ? " is nested too deeply" : " is not there"));
    }
    if (++placings_ > kMostPlacings) {
      return Fail(ErrorCode::kOverBudget,
                  source().name() + ": more than " + std::to_string(kMostPlacings) + " placings");
    }
    const Affine world = parent.is_identity() ? at.transform : parent * at.transform;
    if (found->second.mesh != nullptr) {
      places_[found->first].emplace_back(world, static_cast<std::uint32_t>(item_));
    }
    for (const auto& component : found->second.components) {
      if (auto ok = Visit(component, world, depth + 1); !ok) return ok;
    }
    return {};
  }

  Result<void> AddMesh(const ThreeMfObject& object, const Key& key) {
    const auto places = places_.find(key);
    if (places == places_.end()) return ++unplaced_, Result<void>();
    const std::uint64_t triangles = object.mesh->corners.size() / 3;
    if (triangles == 0) return {};
    const std::size_t first = transforms_.size();
    for (const auto& [transform, item] : places->second) {
      transforms_.push_back(transform);
      items_.push_back(item);
    }
    objects_.push_back({key.first, key.second, &object});
    return AddPlacement({first, places->second.size(), triangles});
  }

  ThreeMfModel model_;
  std::map<Key, std::vector<std::pair<Affine, std::uint32_t>>> places_;  // And the items.
  std::vector<ThreeMfMeshObject> objects_;                               // Of each placement.
  std::vector<Affine> transforms_;
  std::vector<std::uint32_t> items_;  // Of each transform.
  std::vector<MeshAttribute> attributes_;
  std::size_t item_ = 0;  // The one that is visited.
  std::uint64_t placings_ = 0, unplaced_ = 0;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenThreeMf(std::shared_ptr<ZipArchive> archive,
                                                const OpenOptions& options) {
  auto model = ReadThreeMf(*archive, options);
  if (!model) return Forward(model);
  return MakeLoaded<ThreeMfReader>(std::move(archive), std::move(*model));
}

}  // namespace strata::io
