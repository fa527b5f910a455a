// The materials of an OBJ file.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "io/open_mesh.h"

namespace strata::io {

/// A material, as far as colour goes.
struct ObjMaterial {
  std::string name;
  std::string color_map;  ///< The path of map_Kd as the file has it; "" without.
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
  /// Puts names, maps and the number of libraries that were left out into `contents`.
  void Describe(MeshContents& contents) const;

 private:
  Result<void> LoadOne(const std::string& library, const std::string& who,
                       const OpenOptions& options);

  std::vector<std::string> libraries_;
  std::vector<ObjMaterial> materials_;
  std::uint64_t left_out_ = 0;
};

}  // namespace strata::io
