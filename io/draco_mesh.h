// A decoded Draco mesh.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/memory_account.h"
#include "core/mesh_attributes.h"
#include "core/result.h"
#include "io/row_table.h"
#include "io/vertex_store.h"

namespace strata::io {

/// What the points of a Draco mesh carry besides their position.
struct DracoColumns {
  std::vector<MeshAttribute> attributes;
  std::vector<std::uint32_t> numbers;  ///< Of each, in the file's order of attributes.
  std::uint64_t too_wide = 0;          ///< Attributes left out: above kMostComponents.
};

/// Faces of a mesh and, for a while, what its points carry. Memory: taken from the account; after
/// Drop the faces alone. Threads: one at a time.
class DracoMesh {
 public:
  /// Decodes all of `bytes`, after ReadDracoHeader and what DracoDecodeBytes says was taken from
  /// `memory` (null: no account). Errors: those of ReadDracoHeader; kOverBudget; kCorruptInput.
  static Result<DracoMesh> Decode(std::string_view bytes, const std::string& who,
                                  MemoryAccount* memory);
  DracoMesh(DracoMesh&&) noexcept;
  DracoMesh& operator=(DracoMesh&&) noexcept;
  ~DracoMesh();

  std::uint64_t points() const { return points_; }
  const std::vector<std::array<std::uint32_t, 3>>& faces() const { return faces_; }

  /// Appends the points' positions: those of the attribute with this unique id, or of the one that
  /// says so. Errors: kCorruptInput if it is not there or not of three numbers; the store's.
  Result<void> AppendPositions(std::optional<std::uint32_t> unique_id, const std::string& who,
                               VertexStore& to) const;
  /// Values of the attribute with this unique id, component after component, point after point.
  Result<std::vector<double>> Values(std::uint32_t unique_id, const std::string& who,
                                     std::uint32_t components) const;
  /// All attributes but the positions: normals, colours, texture coordinates, others, in the file's
  /// order. A name is the entry `name` of the attribute's metadata, without it that of its type;
  /// the metadata's other whole numbers are a table of names, as Draco's encoder writes it for the
  /// materials and parts of an OBJ.
  DracoColumns Columns() const;
  /// Appends a row a point: the values of the attributes with these numbers, one behind the other,
  /// as they are stored. Errors: kCorruptInput (no such attribute or value); the table's.
  Result<void> AppendRows(std::span<const std::uint32_t> numbers, const std::string& who,
                          RowTable& to) const;
  /// Everything but the faces goes.
  void Drop();

 private:
  struct Decoded;
  DracoMesh();

  std::unique_ptr<Decoded> decoded_;
  std::uint64_t points_ = 0;
  std::vector<std::array<std::uint32_t, 3>> faces_;
  MemoryShare share_, faces_share_;
};

}  // namespace strata::io
