// The base colours of a glTF file's materials, and its images.
#pragma once

#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "io/base_color.h"
#include "io/gltf_buffers.h"

namespace strata::io {

/// Of every material in order, from the document's root: factor, texture with its sampler and
/// KHR_texture_transform; of KHR_materials_pbrSpecularGlossiness the diffuse ones. What is wrong
/// with a material is noted in it: the surface does not depend on any.
std::vector<BaseColor> ReadGltfMaterials(const nlohmann::json& root, const std::string& name);

/// The images of a file, by their numbers in it.
class GltfImages : public TextureImages {
 public:
  /// Both must outlive it.
  GltfImages(GltfBuffers& buffers, const nlohmann::json& root) : buffers_(buffers), root_(root) {}
  std::string NameOf(std::uint32_t image) const override;
  Result<ImageFile> Read(std::uint32_t image, std::uint64_t most, MemoryAccount* memory) override;

 private:
  GltfBuffers& buffers_;
  const nlohmann::json& root_;
  std::map<std::uint32_t, std::shared_ptr<GltfBytes>> open_;
};

}  // namespace strata::io
