// The bytes of a glTF file's buffers and buffer views.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/memory_account.h"
#include "core/result.h"
#include "io/gltf_container.h"
#include "io/gltf_document.h"
#include "io/open_mesh.h"

namespace strata::io {

/// Bytes that can be read at any place. Threads: one at a time.
class GltfBytes {
 public:
  virtual ~GltfBytes() = default;
  virtual std::uint64_t size() const = 0;
  /// Fills `out`. Precondition: offset + out.size() <= size(). Errors: kIo.
  virtual Result<void> Read(std::uint64_t offset, std::span<char> out) = 0;
};

/// Opens buffers when they are first asked for: the binary chunk, data URIs (read where they stand
/// in the JSON, four characters for three bytes), files in the mesh's folder. Views compressed by
/// meshopt are decoded whole, taken from the account and kept until memory is asked for. Threads:
/// one at a time.
class GltfBuffers {
 public:
  /// All must outlive the buffers. `options.memory` may be null.
  GltfBuffers(const GltfContainer& container, const GltfDocument& document,
              const OpenOptions& options)
      : container_(container), document_(document), options_(options) {}

  /// The bytes of a view, of which all were seen to exist. Errors: kCorruptInput, kUnsupported,
  /// kNotFound, kIo, kOverBudget.
  Result<std::shared_ptr<GltfBytes>> View(std::uint32_t view);
  /// The bytes of an image of the document, which must exist. Errors: the same.
  Result<std::shared_ptr<GltfBytes>> Image(std::uint32_t image);
  /// Gives back decoded views that nobody else holds.
  void Trim();
  /// Bytes in the file itself: what claims without bytes of their own are held against.
  std::uint64_t file_size() const { return container_.source->size().value_or(0); }
  const std::string& name() const { return container_.source->name(); }
  MemoryAccount* memory() const { return options_.memory; }

 private:
  Result<std::shared_ptr<GltfBytes>> Buffer(std::uint32_t buffer);
  Result<std::shared_ptr<GltfBytes>> OpenBuffer(std::uint32_t buffer);
  Result<std::shared_ptr<GltfBytes>> OpenUri(const std::string& uri, const std::string& who);
  Result<std::shared_ptr<GltfBytes>> Part(std::uint32_t buffer, std::uint64_t offset,
                                          std::uint64_t length, const std::string& who);
  Result<std::shared_ptr<GltfBytes>> Decode(std::uint32_t view);
  Result<MemoryShare> Take(std::uint64_t bytes, const std::string& who);

  const GltfContainer& container_;
  const GltfDocument& document_;
  const OpenOptions& options_;
  std::map<std::uint32_t, std::shared_ptr<GltfBytes>> buffers_, decoded_;
};

}  // namespace strata::io
