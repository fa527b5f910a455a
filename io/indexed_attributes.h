// Fetching what the faces and vertices of an indexed mesh carry, for points on its triangles.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/base_color.h"
#include "io/row_table.h"

namespace strata::io {

/// Where the components of a value stand in a row, and how.
struct RowField {
  ScalarType type = ScalarType::kFloat32;
  std::vector<std::size_t> offset;  ///< Of each component, from the row's front.
  bool swap = false;                ///< In the other byte order than the machine's.

  /// Copies the value, components one after the other, in the machine's byte order.
  void Copy(const char* row, char* out) const;
  /// Component `k` as a double.
  double Number(const char* row, std::size_t k) const;
};

/// A face, of which some triangle is wanted.
struct AttributedFace {
  std::uint64_t first = 0;  ///< Number of its first triangle.
  std::size_t corners = 0;  ///< How many; a triangle of a strip is a face of three.
  /// Of each corner the row in table t, or -1 if it has none there: table after table.
  std::vector<std::int64_t> rows;
  std::vector<char> values;  ///< The face's own row; empty if it has none.
  std::vector<char> wedges;  ///< A row for each corner; empty if they have none.
};

/// Walks through the faces of a mesh in file order, numbering triangles as its MeshReader does.
class FaceWalker {
 public:
  virtual ~FaceWalker() = default;
  /// Goes on to the face that holds this triangle; numbers ascend from call to call, and the face
  /// of the call before may hold it too. Errors: kCorruptInput, kIo.
  virtual Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) = 0;
};

/// From where a value comes.
struct AttributeSource {
  /// kColor: IndexedMesh::colors gives it, at texture coordinates from the table.
  enum class Place : std::uint8_t { kTable, kFace, kWedge, kColor };
  Place place = Place::kTable;
  std::size_t table = 0;
  RowField field;
};

struct IndexedMesh {
  std::string name;  ///< For messages.
  std::unique_ptr<FaceWalker> faces;
  std::vector<std::unique_ptr<RowTable>> tables;
  /// Where x, y and z stand in the rows of table 0, which polygons of more than three corners need.
  std::array<RowField, 3> position;
  std::size_t wedge_bytes = 0;
  /// For attributes that are looked up: the number of its material in a face's own row, and where
  /// colours come from.
  RowField material{};
  std::unique_ptr<BaseColorLookup> colors{};
};

/// A pass over such a mesh. `attributes` and `sources` go together. A value that a corner or face
/// does not have is NaN, of integers 0. What `mesh` refers to must outlive the pass.
std::unique_ptr<AttributePass> PassOver(IndexedMesh mesh, std::vector<MeshAttribute> attributes,
                                        std::vector<AttributeSource> sources, RunContext& context);

}  // namespace strata::io
