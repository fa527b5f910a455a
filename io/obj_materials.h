// The materials of an OBJ file.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/base_color.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// A material, as far as colour goes.
struct ObjMaterial {
  std::string name;
  std::string library{};    ///< The file that it stands in, as mtllib has it, without quotes.
  std::string color_map{};  ///< The path of map_Kd as the file has it; "" without.
  bool clamp = false;       ///< Of that map: -clamp on; else it repeats.
  std::array<double, 2> offset = {0, 0}, scale = {1, 1};  ///< -o and -s: uv * scale + offset.
  std::array<double, 3> diffuse = {1, 1, 1};              ///< Kd, 0 to 1, as encoded for display.
};

/// Images in files that a mesh names.
class FileImages : public TextureImages {
 public:
  /// `who`: the mesh's name. `paths` are as the mesh has them (RelativePathOfName). One in quotes
  /// is the file of that very name or, where there is none, the one that the quotes enclose.
  FileImages(std::string who, std::vector<std::string> paths, const OpenOptions& options)
      : who_(std::move(who)), paths_(std::move(paths)), companions_(options.companions) {}
  std::string NameOf(std::uint32_t image) const override;
  Result<ImageFile> Read(std::uint32_t image, std::uint64_t most, MemoryAccount* memory) override;
  const std::vector<std::string>& paths() const { return paths_; }

 private:
  const std::string who_;
  const std::vector<std::string> paths_;
  const std::shared_ptr<const CompanionFiles> companions_;
  std::map<std::uint32_t, std::unique_ptr<ByteSource>> open_;
};

/// Base colours by the numbers of an OBJ's materials, and the images they name.
struct ObjColors {
  std::vector<BaseColor> materials;
  std::unique_ptr<FileImages> images;

  /// Whether any has a texture, or might have if its library were there.
  bool textured() const;
};

/// Reads the files that `mtllib` statements name. They lie in OpenOptions::companions; the surface
/// does not depend on them, so that one that is missing, leads elsewhere or is damaged only leaves
/// its materials out. Memory: lines are bounded by OpenOptions::max_line_bytes, materials by
/// 65,536. Threads: one.
class ObjMaterials {
 public:
  /// `rest` is what follows the keyword: one name, blanks inside included.
  void AddLibrary(std::string_view rest);
  bool any() const { return !libraries_.empty(); }

  /// Reads all libraries, in order. Errors: kIo alone.
  Result<void> Load(const std::string& who, const OpenOptions& options);
  /// Of materials of the same name the first counts.
  const std::vector<ObjMaterial>& materials() const { return materials_; }
  /// The colours of materials by name. A name that no library has is white; where a library was
  /// left out, too, that is the material's fault.
  ObjColors ColorsOf(const std::vector<std::string>& names, const std::string& who,
                     const OpenOptions& options) const;
  /// Puts names, maps and the number of libraries that were left out into `contents`.
  void Describe(MeshContents& contents) const;

 private:
  Result<void> LoadOne(const std::string& library, const std::string& who,
                       const OpenOptions& options);

  std::vector<std::string> libraries_;
  std::vector<ObjMaterial> materials_;
  std::uint64_t left_out_ = 0;
  std::optional<Error> fault_;  // Of the first that was left out.
};

}  // namespace strata::io
