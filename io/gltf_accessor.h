// Reading the values of a glTF accessor.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "io/gltf_buffers.h"
#include "io/gltf_document.h"

namespace strata::io {

/// An accessor's elements, read a run at a time, sparse ones put in their places. Memory: a small
/// buffer and the sparse part. Threads: one at a time.
class GltfValues {
 public:
  /// Checks that every byte is there. An accessor without bytes of its own is zeros; of those only
  /// as many elements are allowed as the file has bytes, and 65,536 in any case. Errors: those of
  /// GltfBuffers::View; kCorruptInput; kOverBudget.
  static Result<GltfValues> Open(GltfBuffers& buffers, const GltfDocument& document,
                                 std::uint32_t accessor);

  std::uint64_t count() const { return accessor_->count; }
  std::uint32_t components() const { return accessor_->components; }
  const GltfAccessor& accessor() const { return *accessor_; }

  /// The elements from number `first` on, component after component; normalised integers become
  /// fractions. Preconditions: out.size() is a multiple of components(), and they exist. Errors:
  /// kIo.
  Result<void> Read(std::uint64_t first, std::span<double> out);
  /// The same as whole numbers. Precondition: the components are unsigned.
  Result<void> Read(std::uint64_t first, std::span<std::uint32_t> out);

 private:
  GltfValues() = default;
  Result<void> OpenSparse(GltfBuffers& buffers, const GltfDocument& document,
                          const std::string& who);
  template <class Out>
  Result<void> ReadAs(std::uint64_t first, std::span<Out> out);
  template <class Out>
  Result<void> ReadDense(std::uint64_t first, std::span<Out> out);

  const GltfAccessor* accessor_ = nullptr;
  std::shared_ptr<GltfBytes> bytes_;  // Null: zeros.
  std::uint64_t stride_ = 0;
  std::vector<char> buffer_;
  MemoryShare share_;
  std::vector<std::uint32_t> sparse_indices_;  // Ascending.
  std::vector<char> sparse_values_;            // One element after the other.
};

}  // namespace strata::io
