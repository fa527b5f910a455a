#include "io/gltf_reader.h"

#include <array>
#include <map>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/gltf_attributes.h"
#include "io/gltf_buffers.h"
#include "io/gltf_container.h"
#include "io/gltf_document.h"
#include "io/gltf_geometry.h"
#include "io/gltf_materials.h"
#include "io/gltf_scene.h"
#include "io/placed_reader.h"
#include "io/within_memory.h"

namespace strata::io {
namespace {

class GltfReader : public PlacedReader {
 public:
  // `source` is the container's.
  GltfReader(GltfContainer container, std::unique_ptr<ByteSource> source,
             const OpenOptions& options)
      : PlacedReader(std::move(source)),
        container_(std::move(container)),
        options_(options),
        buffers_(container_, document_, options_),
        images_(buffers_, container_.json.root) {
    info_.format = container_.binary ? "glb" : "gltf";
    info_.encoding = "binary_little_endian";
    info_.compression = this->source().compression();
  }

  Result<void> Load() {
    auto document = ReadGltfDocument(container_.json.root, source().name());
    if (!document) return Forward(document);
    document_ = std::move(*document);
    auto scene = UnrollGltf(buffers_, document_);
    if (!scene) return Forward(scene);
    scene_ = std::move(*scene);
    if (auto ok = AddDraws(); !ok) return ok;
    info_.contents = document_.contents;
    info_.contents.meshes = document_.meshes.size();
    info_.contents.instances = scene_.instances.size();
    for (const auto& [what, n] : passed_over_) info_.contents.passed_over.emplace_back(what, n);
    materials_ = ReadGltfMaterials(container_.json.root, this->source().name());
    columns_ = ListGltfColumns(document_, materials_, draws_);
    for (const GltfColumn& column : columns_) attributes_.push_back(column.attribute);
    return Rewind();
  }

  std::span<const MeshAttribute> attributes() const override { return attributes_; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    DropGeometry();
    std::vector<GltfColumn> wanted;
    for (const std::size_t n : numbers) wanted.push_back(columns_[n]);
    const auto locate = [this](std::uint64_t triangle) -> GltfPlace {
      const Location at = Locate(triangle);
      return {at.placement, at.triangle, at.transform};
    };
    return PassOverGltf(
        {buffers_, document_, scene_, draws_, materials_, images_, options_, locate},
        std::move(wanted), context);
  }
  Result<void> CheckAttribute(std::size_t number, CheckDepth depth, RunContext& context) override {
    if (columns_[number].from != GltfColumn::From::kTexture) return {};
    std::vector<BaseColor> used;
    for (const std::uint32_t k : MaterialsOf(document_, draws_)) used.push_back(materials_[k]);
    return CheckTextures(images_, used, depth, context);
  }
  std::vector<MeshTexture> InspectTextures(RunContext& context) override {
    std::vector<MeshTexture> textures;
    for (const std::string& place : info_.contents.textures) {
      MeshTexture& texture = textures.emplace_back();
      const auto number = static_cast<std::uint32_t>(textures.size() - 1);
      texture.place = place;
      Inspect(images_, number, &context.memory(), texture);
      for (std::uint32_t k = 0; k < materials_.size(); ++k) {
        if (materials_[k].image == number) texture.materials.push_back(k);
      }
    }
    return textures;
  }

 protected:
  Result<std::shared_ptr<PlacedGeometry>> LoadGeometry(std::size_t draw) override {
    buffers_.Trim();
    auto loaded = GltfGeometry::Load(buffers_, document_, scene_, draws_[draw], options_);
    if (!loaded) return Forward(loaded);
    return std::shared_ptr<PlacedGeometry>(std::move(*loaded));
  }
  const Affine& TransformOf(std::size_t number) const override {
    return scene_.instances[number].transform;
  }

 private:
  bool HasSurface(const GltfPrimitive& primitive) {
    constexpr std::array kNames = {"points primitives", "lines primitives", "lines primitives",
                                   "lines primitives"};
    const auto mode = static_cast<std::size_t>(primitive.mode);
    if (mode < kNames.size()) return ++passed_over_[kNames[mode]], false;
    if (!primitive.attributes.contains("POSITION")) {
      return ++passed_over_["primitives without positions"], false;
    }
    return true;
  }

  // Those that have triangles.
  Result<void> AddDraws() {
    std::set<std::uint32_t> counted;
    for (const GltfDraw& draw : scene_.draws) {
      const GltfPrimitive& primitive = document_.meshes[draw.mesh].primitives[draw.primitive];
      if (!HasSurface(primitive)) continue;
      const auto size = MeasureGltf(buffers_, document_, draw.mesh, draw.primitive);
      if (!size) return Forward(size);
      // A vertex list that several primitives use is one.
      const bool first = counted.insert(primitive.attributes.at("POSITION")).second;
      if (first) vertex_count_ += size->vertices;
      if (size->triangles == 0) continue;
      draws_.push_back(draw);
      const Placement placement{draw.first_instance, draw.instances, size->triangles};
      if (auto ok = AddPlacement(placement); !ok) return ok;
    }
    buffers_.Trim();
    return {};
  }

  GltfContainer container_;
  const OpenOptions options_;
  GltfDocument document_;
  GltfBuffers buffers_;
  GltfImages images_;
  std::vector<BaseColor> materials_;
  GltfScene scene_;
  std::map<std::string, std::uint64_t> passed_over_;
  std::vector<GltfDraw> draws_;
  std::vector<GltfColumn> columns_;
  std::vector<MeshAttribute> attributes_;
};

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenGltf(std::unique_ptr<ByteSource> source,
                                             const OpenOptions& options) {
  using Opened = Result<std::unique_ptr<MeshReader>>;
  return WithinMemory(source->name() + ": the mesh does not fit into memory", [&]() -> Opened {
    auto container = OpenGltfContainer(std::move(source), options);
    if (!container) return Forward(container);
    auto opened = container->Release();
    return MakeLoaded<GltfReader>(std::move(*container), std::move(opened), options);
  });
}

}  // namespace strata::io
