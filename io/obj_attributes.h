// What an OBJ carries besides positions and faces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/byte_source.h"
#include "io/obj_materials.h"

namespace strata::io {

/// What a line of an OBJ says; `rest` is what follows the keyword.
struct ObjStatement {
  enum class Kind : std::uint8_t {
    kOther,
    kVertex,
    kUv,
    kNormal,
    kFace,
    kGroup,
    kObject,
    kMaterial
  };
  static constexpr int kNamed = 3;  ///< The last three of them.

  Kind kind = Kind::kOther;
  std::string_view rest;
};
ObjStatement ClassifyObj(std::string_view line);

/// Names in the order of their first appearance. The first is what faces have before any is said.
class ObjNames {
 public:
  /// More distinct names than this are no table.
  static constexpr std::size_t kMost = std::size_t{1} << 20;

  /// The number of a name, a new one if need be.
  std::uint32_t Add(std::string_view name);
  /// The number of a name; 0 if it has none.
  std::uint32_t Find(std::string_view name) const;
  const std::vector<std::string>& list() const { return list_; }
  bool empty() const { return list_.empty(); }
  /// For faces that no statement precedes.
  void AddDefault();

 private:
  std::vector<std::string> list_;
  std::map<std::string, std::uint32_t, std::less<>> numbers_;
};

/// Finds what an OBJ carries while its lines pass by for the first time.
class ObjContents {
 public:
  void Note(const ObjStatement& statement);
  /// `uv` (vt), `vertex_normal` (vn), `color` (v x y z r g b), and the ids `group` (g), `object`
  /// (o) and `material` (usemtl), as far as they are there. A face before the first g, o or usemtl
  /// has the name "default".
  std::vector<MeshAttribute> Attributes() const;
  const ObjNames& names(std::size_t k) const { return names_[k]; }
  /// The materials' names; empty if there are too many for a table.
  std::vector<std::string> MaterialNames() const {
    return too_many_[2] ? std::vector<std::string>() : names_[2].list();
  }

 private:
  bool has_uv_ = false, has_normal_ = false, has_color_ = false, seen_vertex_ = false;
  ObjNames names_[ObjStatement::kNamed];  // Groups, objects, materials.
  bool too_many_[ObjStatement::kNamed] = {};
};

/// A pass that fetches `wanted` of what Attributes() gave, and TextureAttribute, which it looks up
/// in `colors`. Reads the file from its start, twice if
/// something of the corners is wanted. What is referred to must outlive it, and nobody else may
/// read from `source` meanwhile.
Result<std::unique_ptr<AttributePass>> OpenObjAttributes(
    ByteSource& source, std::size_t max_line_bytes, const ObjContents& contents,
    const ObjColors& colors, std::span<const MeshAttribute> wanted, RunContext& context);

}  // namespace strata::io
