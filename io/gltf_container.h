// The JSON of a glTF file and the bytes that stand behind it.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <utility>

#include "core/result.h"
#include "io/byte_source.h"
#include "io/json_text.h"
#include "io/open_mesh.h"

namespace strata::io {

/// What a .gltf or .glb holds. Memory: the JSON text and its tree, taken from the account.
struct GltfContainer {
  ByteSource* source = nullptr;  ///< ReadAt works.
  bool binary = false;           ///< GLB.
  JsonText json;
  /// The binary chunk of a GLB, as a part of `source`.
  struct Chunk {
    std::uint64_t offset = 0, size = 0;
  };
  std::optional<Chunk> chunk;

  /// Hands the source over to somebody who must keep it as long as the container.
  std::unique_ptr<ByteSource> Release() { return std::move(owned); }
  std::unique_ptr<ByteSource> owned;
};

/// Reads the container; its version must be 2. Errors: kCorruptInput, kUnsupported, kOverBudget,
/// kIo.
Result<GltfContainer> OpenGltfContainer(std::unique_ptr<ByteSource> source,
                                        const OpenOptions& options);

}  // namespace strata::io
