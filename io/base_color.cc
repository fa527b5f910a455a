#include "io/base_color.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "io/srgb.h"

namespace strata::io {
namespace {

// Most heads lie in as many; behind a long profile a JPEG's may not.
constexpr std::uint64_t kFrontBytes = std::uint64_t{1} << 16;

Rgba Times(const Rgba& a, const Rgba& b) {
  return {a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]};
}

Result<void> CheckFits(TextureImages& images, std::uint32_t image, MemoryAccount& memory) {
  const auto head = HeadOf(images, image, &memory);
  if (!head) return Forward(head);
  const auto fits = memory.Take(head->pixel_bytes() + head->working_bytes(),
                                images.NameOf(image) + ": the " + std::to_string(head->width) +
                                    " x " + std::to_string(head->height) + " pixels of the image");
  if (!fits) return Forward(fits);
  return {};
}

Result<Image> Decode(TextureImages& images, std::uint32_t image, RunContext& context) {
  const auto file =
      images.Read(image, std::numeric_limits<std::uint64_t>::max(), &context.memory());
  if (!file) return Forward(file);
  return DecodeImage(file->bytes, images.NameOf(image), &context.memory(), &context);
}

}  // namespace

std::array<double, 2> CarryUv(const std::array<std::array<double, 2>, 3>& corner,
                              const std::array<double, 3>& weight) {
  static const MeshAttribute attribute = [] {
    MeshAttribute uv;
    uv.type = ScalarType::kFloat64;
    uv.components = 2;
    return uv;
  }();
  std::array<double, 2> uv;
  const auto bytes = [](const auto& value) { return reinterpret_cast<const char*>(value.data()); };
  CarryValue(attribute, {bytes(corner[0]), bytes(corner[1]), bytes(corner[2])}, weight,
             reinterpret_cast<char*>(uv.data()));
  return uv;
}

Result<ImageFile> ReadImageFile(std::uint64_t size, std::uint64_t most, MemoryAccount* memory,
                                const std::string& who,
                                const std::function<Result<void>(std::span<char>)>& read) {
  ImageFile file;
  file.size = size;
  const auto wanted = static_cast<std::size_t>(std::min(most, size));
  if (memory != nullptr) {
    auto share = memory->Take(wanted, who);
    if (!share) return Forward(share);
    file.share = std::move(*share);
  }
  file.bytes.resize(wanted);
  if (auto got = read(file.bytes); !got) return Forward(got);
  return file;
}

Result<ImageHead> HeadOf(TextureImages& images, std::uint32_t image, MemoryAccount* memory) {
  auto file = images.Read(image, kFrontBytes, memory);
  if (!file) return Forward(file);
  auto head = ReadImageHead(file->bytes, file->size, images.NameOf(image));
  if (head && !*head) {
    *file = {};
    file = images.Read(image, std::numeric_limits<std::uint64_t>::max(), memory);
    if (!file) return Forward(file);
    head = ReadImageHead(file->bytes, file->size, images.NameOf(image));
  }
  if (!head) return Forward(head);
  return **head;
}

void Inspect(TextureImages& images, std::uint32_t image, MemoryAccount* memory,
             MeshTexture& texture) {
  const auto file = images.Read(image, 0, memory);
  const auto head = file ? HeadOf(images, image, memory) : Result<ImageHead>(Forward(file));
  if (file) texture.bytes = file->size;
  if (!head) {
    texture.fault = head.error().message;
    return;
  }
  texture.type = NameOf(head->type);
  texture.width = head->width;
  texture.height = head->height;
  texture.channels = head->channels;
  texture.bits = head->bits;
}

MeshAttribute TextureAttribute(bool opaque) {
  MeshAttribute attribute;
  attribute.name = "texture";
  attribute.type = ScalarType::kUint8;
  attribute.components = opaque ? 3 : 4;
  attribute.domain = AttributeDomain::kTriangle;
  attribute.carry = Carry::kLookedUp;
  attribute.normalized = true;
  attribute.semantic = Semantic::kTexture;
  attribute.color_space = ColorSpace::kSrgb;
  return attribute;
}

Result<void> CheckTextures(TextureImages& images, std::span<const BaseColor> materials,
                           CheckDepth depth, RunContext& context) {
  std::vector<std::uint32_t> checked;
  for (const BaseColor& material : materials) {
    if (material.fault) return tl::unexpected<Error>(*material.fault);
    if (!material.image) continue;
    checked.push_back(*material.image);
  }
  std::sort(checked.begin(), checked.end());
  checked.erase(std::unique(checked.begin(), checked.end()), checked.end());
  for (const std::uint32_t image : checked) {
    if (auto fits = CheckFits(images, image, context.memory()); !fits) return fits;
    if (depth == CheckDepth::kHeads) continue;
    if (auto decoded = Decode(images, image, context); !decoded) return Forward(decoded);
  }
  return {};
}

BaseColorLookup::BaseColorLookup(TextureImages& images, const std::vector<BaseColor>& materials,
                                 int components, RunContext& context)
    : images_(images),
      materials_(materials),
      components_(components),
      context_(context),
      most_bytes_(context.memory().limited() ? context.memory().left() / 2
                                             : std::numeric_limits<std::uint64_t>::max()) {}

Result<void> BaseColorLookup::Add(std::optional<std::uint32_t> material, double u, double v,
                                  char* out) {
  if (!material || *material >= materials_.size()) return Put({1, 1, 1, 1}, out), Result<void>();
  const BaseColor& color = materials_[*material];
  if (color.fault) return tl::unexpected<Error>(*color.fault);
  const auto& m = color.transform.m;
  const double x = m[0] * u + m[1] * v + m[2], y = m[3] * u + m[4] * v + m[5];
  if (!color.image || !std::isfinite(x) || !std::isfinite(y)) {
    Rgba alone = color.factor;
    if (color.opaque) alone[3] = 1;
    return Put(alone, out), Result<void>();
  }
  waiting_[*color.image].push_back({*material, x, y, out});
  return {};
}

void BaseColorLookup::Put(const Rgba& color, char* out) const {
  for (std::size_t k = 0; k < 3; ++k) out[k] = static_cast<char>(Srgb8OfLinear(color[k]));
  if (components_ == 4) {
    const double alpha = std::clamp(color[3], 0.0, 1.0) * 255 + 0.5;
    out[3] = static_cast<char>(static_cast<std::uint8_t>(alpha));
  }
}

Result<void> BaseColorLookup::Flush() {
  // What is at hand first, before it has to go.
  for (const bool held : {true, false}) {
    for (auto& [image, points] : waiting_) {
      if (points.empty() || (held && !Holds(image))) continue;
      if (context_.cancelled()) return Cancelled();
      if (auto filled = Fill(image, points); !filled) return filled;
      points.clear();
    }
  }
  return {};
}

Result<void> BaseColorLookup::Fill(std::uint32_t image, const std::vector<Point>& points) {
  const auto loaded = Load(image);
  if (!loaded) return Forward(loaded);
  for (const Point& point : points) {
    const BaseColor& material = materials_[point.material];
    Rgba color = Times(LookUp(**loaded, material.sampler, point.u, point.v), material.factor);
    if (material.opaque) color[3] = 1;
    Put(color, point.out);
  }
  return {};
}

bool BaseColorLookup::Holds(std::uint32_t image) const {
  return std::any_of(held_.begin(), held_.end(),
                     [image](const Held& held) { return held.number == image; });
}

bool BaseColorLookup::DropOldest() {
  if (held_.empty()) return false;
  held_bytes_ -= held_.back().image->head().pixel_bytes();
  held_.pop_back();
  return true;
}

Result<const Image*> BaseColorLookup::Load(std::uint32_t image) {
  const auto found = std::find_if(held_.begin(), held_.end(),
                                  [image](const Held& held) { return held.number == image; });
  if (found != held_.end()) {
    held_.splice(held_.begin(), held_, found);
    return held_.front().image.get();
  }
  const auto head = HeadOf(images_, image, &context_.memory());
  if (!head) return Forward(head);
  while (!held_.empty() && held_bytes_ + head->pixel_bytes() > most_bytes_) DropOldest();
  for (;;) {
    auto decoded = Decode(images_, image, context_);
    if (decoded) {
      held_.push_front({image, std::make_unique<Image>(std::move(*decoded))});
      held_bytes_ += held_.front().image->head().pixel_bytes();
      return held_.front().image.get();
    }
    // What was decoded before may stand in the way.
    if (decoded.error().code != ErrorCode::kOverBudget || !DropOldest()) return Forward(decoded);
  }
}

}  // namespace strata::io
