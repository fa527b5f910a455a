#include "io/gltf_materials.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "io/json_text.h"
#include "io/quote.h"

namespace strata::io {
namespace {

// So many files are held open at once.
constexpr std::size_t kMostOpen = 64;
constexpr std::uint64_t kMostIndex = 0xfffffffe;
constexpr std::uint64_t kMostSets = 999;

class MaterialReader {
 public:
  MaterialReader(const nlohmann::json& root, const std::string& name)
      : failure_{&name, {}, false}, root_(root, failure_) {}

  BaseColor Read(std::size_t number) {
    const JsonAt material = root_["materials"].at(number);
    BaseColor color;
    color.opaque = material["alphaMode"].String("OPAQUE") == "OPAQUE";
    const JsonAt older = material["extensions"]["KHR_materials_pbrSpecularGlossiness"];
    const JsonAt usual = material["pbrMetallicRoughness"];
    const JsonAt& values = older.present() ? older : usual;
    color.factor =
        Numbers<4>(values[older.present() ? "diffuseFactor" : "baseColorFactor"], {1, 1, 1, 1});
    const JsonAt texture = values[older.present() ? "diffuseTexture" : "baseColorTexture"];
    if (texture.present()) ReadTexture(texture, color);
    if (failure_.failed) color.fault = failure_.error;
    return color;
  }

 private:
  template <std::size_t n>
  std::array<double, n> Numbers(const JsonAt& at, std::array<double, n> numbers) {
    if (!at.present()) return numbers;
    if (at.size() != n) at.Reject("expected " + std::to_string(n) + " numbers");
    for (std::size_t k = 0; k < n && !failure_.failed; ++k) numbers[k] = at.at(k).Number();
    return numbers;
  }

  // One of a list of the root.
  std::optional<JsonAt> Element(const char* list, const JsonAt& index) {
    const std::uint64_t number = index.Uint(kMostIndex);
    const JsonAt elements = root_[list];
    if (failure_.failed) return std::nullopt;
    const std::size_t size = elements.size();
    if (number < size) return elements.at(static_cast<std::size_t>(number));
    index.Reject("found index " + std::to_string(number) + " of " + std::to_string(size));
    return std::nullopt;
  }

  void ReadTexture(const JsonAt& info, BaseColor& color) {
    const JsonAt placing = info["extensions"]["KHR_texture_transform"];
    const std::uint64_t set = info["texCoord"].Uint(kMostSets, 0);
    color.uv_set = static_cast<int>(placing["texCoord"].Uint(kMostSets, set));
    color.transform =
        UvTransform::FromTrs(Numbers<2>(placing["offset"], {0, 0}), placing["rotation"].Number(0),
                             Numbers<2>(placing["scale"], {1, 1}));
    const auto texture = Element("textures", info["index"]);
    if (!texture) return;
    if ((*texture)["sampler"].present()) {
      if (const auto sampler = Element("samplers", (*texture)["sampler"])) {
        color.sampler = Sampler(*sampler);
      }
    }
    const JsonAt webp = (*texture)["extensions"]["EXT_texture_webp"]["source"];
    const JsonAt source = webp.present() ? webp : (*texture)["source"];
    if (!source.present()) {
      return texture->Reject("has no image that is read; expected PNG, JPEG or WebP",
                             ErrorCode::kUnsupported);
    }
    if (Element("images", source)) {
      color.image = static_cast<std::uint32_t>(source.Uint(kMostIndex));
    }
  }

  Wrap WrapOf(const JsonAt& at) {
    switch (const std::uint64_t mode = at.Uint(kMostIndex, 10497)) {
      case 10497:
        return Wrap::kRepeat;
      case 33648:
        return Wrap::kMirror;
      case 33071:
        return Wrap::kClamp;
      default:
        at.Reject("found the wrapping mode " + std::to_string(mode));
        return Wrap::kRepeat;
    }
  }

  TextureSampler Sampler(const JsonAt& at) {
    constexpr std::uint64_t kNearest = 9728, kLinear = 9729;
    const std::uint64_t filter = at["magFilter"].Uint(kMostIndex, kLinear);
    if (filter != kNearest && filter != kLinear) {
      at["magFilter"].Reject("found the filter " + std::to_string(filter));
    }
    return {WrapOf(at["wrapS"]), WrapOf(at["wrapT"]), filter == kNearest};
  }

  JsonAt::Failure failure_;
  const JsonAt root_;
};

}  // namespace

std::vector<BaseColor> ReadGltfMaterials(const nlohmann::json& root, const std::string& name) {
  std::vector<BaseColor> colors;
  const auto list = root.find("materials");
  if (list == root.end() || !list->is_array()) return colors;
  for (std::size_t k = 0; k < list->size(); ++k) {
    colors.push_back(MaterialReader(root, name).Read(k));
  }
  return colors;
}

std::string GltfImages::NameOf(std::uint32_t image) const {
  std::string name = buffers_.name() + ": /images/" + std::to_string(image);
  const auto uri = root_["images"][image].find("uri");
  if (uri == root_["images"][image].end() || !uri->is_string()) return name;
  const std::string& text = uri->get_ref<const std::string&>();
  return text.starts_with("data:") ? name : name + " (" + Quoted(text) + ")";
}

Result<ImageFile> GltfImages::Read(std::uint32_t image, std::uint64_t most, MemoryAccount* memory) {
  auto found = open_.find(image);
  if (found == open_.end()) {
    auto opened = buffers_.Image(image);
    if (!opened) return Forward(opened);
    if (open_.size() >= kMostOpen) open_.erase(open_.begin());
    found = open_.emplace(image, std::move(*opened)).first;
  }
  GltfBytes& bytes = *found->second;
  return ReadImageFile(bytes.size(), most, memory, NameOf(image) + ": the bytes of the image",
                       [&](std::span<char> out) { return bytes.Read(0, out); });
}

}  // namespace strata::io
