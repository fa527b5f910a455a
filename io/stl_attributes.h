// What the facets of a binary STL carry: their attribute bytes, and the colours some programs keep
// there.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/result.h"
#include "core/run_context.h"
#include "io/byte_source.h"

namespace strata::io {

/// How a facet's two attribute bytes are a colour.
struct StlColors {
  enum class Kind : std::uint8_t {
    kNone,
    kVisCam,  ///< 5 bits each of red, green and blue from bit 10 down, if bit 15 is set.
    kMagics,  ///< The same from bit 0 up, if bit 15 is not set: otherwise the whole file's colour.
  };
  Kind kind = Kind::kNone;
  std::array<std::uint8_t, 3> whole = {0, 0, 0};  ///< Of facets that have none of their own.

  /// A header with "COLOR=" is Magics'; otherwise a first facet with bit 15 set means VisCAM.
  /// `head` is the file's first 134 bytes, or all.
  static StlColors Of(std::string_view head);
  std::array<std::uint8_t, 3> ColorOf(std::uint16_t attribute) const;
  /// `attribute`, and `color` if there are colours.
  std::vector<MeshAttribute> Attributes() const;
};

/// A pass that fetches `wanted` of what Attributes() gave. `source` must outlive it, and nobody
/// else may read from it meanwhile.
Result<std::unique_ptr<AttributePass>> OpenStlAttributes(ByteSource& source,
                                                         const StlColors& colors,
                                                         std::span<const MeshAttribute> wanted,
                                                         RunContext& context);

}  // namespace strata::io
