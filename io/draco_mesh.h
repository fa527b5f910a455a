// A decoded Draco mesh.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "io/vertex_store.h"

namespace strata::io {

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
