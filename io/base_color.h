// The colours that materials give to a surface: a factor and a texture.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/memory_account.h"
#include "core/mesh_attributes.h"
#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/image.h"
#include "io/texture_sampler.h"

namespace strata::io {

/// How a material colours the surface: factor times texture.
struct BaseColor {
  Rgba factor = {1, 1, 1, 1};
  std::optional<std::uint32_t> image;  ///< A number of TextureImages.
  int uv_set = 0;
  TextureSampler sampler;
  UvTransform transform;
  bool opaque = true;          ///< Alpha has no meaning, and is 1.
  std::optional<Error> fault;  ///< Why the texture cannot be looked up, whatever the image.
};

/// Texture coordinates at a point from those at its triangle's corners (CarryValue, in double).
std::array<double, 2> CarryUv(const std::array<std::array<double, 2>, 3>& corner,
                              const std::array<double, 3>& weight);

/// Bytes of an image file, and the memory they take from the account.
struct ImageFile {
  std::string bytes;  ///< The first of them, as many as were asked for.
  std::uint64_t size = 0;
  MemoryShare share;
};

/// The first `most` bytes of a file of `size`, which `read` puts into a buffer from its beginning;
/// their memory is taken from `memory` if given, for what `who` names. Errors: kOverBudget; those
/// of `read`.
Result<ImageFile> ReadImageFile(std::uint64_t size, std::uint64_t most, MemoryAccount* memory,
                                const std::string& who,
                                const std::function<Result<void>(std::span<char>)>& read);

/// The images that a mesh names, each by its number. Threads: one at a time.
class TextureImages {
 public:
  virtual ~TextureImages() = default;
  /// Of which file and which of its images, for messages.
  virtual std::string NameOf(std::uint32_t image) const = 0;
  /// The first `most` bytes of one, taken from `memory` if given. Errors: kNotFound, kUnsupported
  /// (a place that is not opened), kCorruptInput, kOverBudget, kIo.
  virtual Result<ImageFile> Read(std::uint32_t image, std::uint64_t most,
                                 MemoryAccount* memory) = 0;
};

/// The head of an image. Errors: those of TextureImages and ReadImageHead.
Result<ImageHead> HeadOf(TextureImages& images, std::uint32_t image, MemoryAccount* memory);
/// Fills type, sizes and fault of `texture`.
void Inspect(TextureImages& images, std::uint32_t image, MemoryAccount* memory,
             MeshTexture& texture);

/// The attribute `texture` of a mesh with these materials: three components, or four where one of
/// them is not opaque.
MeshAttribute TextureAttribute(bool opaque);

/// Whether all images of these materials are there, have a head and fit the account one by one;
/// kWhole decodes them, too. Errors: the materials' faults; those of HeadOf and DecodeImage.
Result<void> CheckTextures(TextureImages& images, std::span<const BaseColor> materials,
                           CheckDepth depth, RunContext& context);

/// Looks up the colours of points, in portions: those of one image together, so that an image is
/// decoded at most once a portion. Threads: one at a time. Memory: decoded images, taken from the
/// context's account: those used last, up to half of what is left of it, or one; 64 bytes a point.
class BaseColorLookup {
 public:
  /// All must outlive it. `components`: as the attribute has, 3 or 4.
  BaseColorLookup(TextureImages& images, const std::vector<BaseColor>& materials, int components,
                  RunContext& context);

  /// A point of a material at (u, v); without a material it is white, without finite coordinates
  /// the factor alone. `out` takes `components` bytes, sRGB, by the end of Flush. Errors: the
  /// material's fault.
  Result<void> Add(std::optional<std::uint32_t> material, double u, double v, char* out);
  /// Errors: those of TextureImages and DecodeImage; kCancelled.
  Result<void> Flush();

 private:
  struct Point {
    std::uint32_t material;
    double u, v;
    char* out;
  };
  struct Held {
    std::uint32_t number;
    std::unique_ptr<Image> image;
  };

  void Put(const Rgba& color, char* out) const;
  Result<void> Fill(std::uint32_t image, const std::vector<Point>& points);
  Result<const Image*> Load(std::uint32_t image);
  bool DropOldest();
  bool Holds(std::uint32_t image) const;

  TextureImages& images_;
  const std::vector<BaseColor>& materials_;
  const int components_;
  RunContext& context_;
  const std::uint64_t most_bytes_;  // Of held images, if they are several.
  std::uint64_t held_bytes_ = 0;
  std::list<Held> held_;  // The one used last in front.
  std::map<std::uint32_t, std::vector<Point>> waiting_;
};

}  // namespace strata::io
