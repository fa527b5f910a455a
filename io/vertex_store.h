// Where an indexed mesh's vertices end up while it is opened: in memory, or on disk if too many.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "core/memory_account.h"
#include "io/byte_source.h"
#include "io/far_vertices.h"
#include "io/open_mesh.h"
#include "io/vertex_array.h"
#include "io/vertex_file.h"

namespace strata::io {

/// Takes vertices one by one or in bulk; Finish settles where they are. Within the budget they are
/// in memory and far() is null; beyond it view() is empty. Failures are kept, so that inner loops
/// test a bool: once a call has returned false, failure() says why and the store is spent. Threads:
/// one at a time. Throws std::bad_alloc.
class VertexStore {
 public:
  /// `name` is the input's, for messages. What `options` points at must outlive the store.
  VertexStore(std::string name, const OpenOptions& options);
  VertexStore(const ByteSource& source, const OpenOptions& options)
      : VertexStore(source.name(), options) {}

  std::uint64_t size() const { return spilled_ + array_.size(); }

  bool Append(double x, double y, double z) {
    if (limited_ && WouldNotWiden(x, y, z) && !Spill()) return false;
    array_.Append(x, y, z);
    return Settle();
  }
  /// In bulk: appended to array(), no more at once than a reader's buffer holds, then settled.
  VertexArray& array() { return array_; }
  bool Settle() { return array_.bytes() <= spill_at_ || Spill(); }

  /// Whether so many vertices stay in memory.
  bool Fits(std::uint64_t vertices, bool is_double) const {
    return vertices <= budget_ / (is_double ? 24 : 12);
  }
  /// Takes vertices that lie in a file already. Precondition: size() == 0.
  bool Adopt(std::unique_ptr<VertexFile> file);

  /// After the last vertex. Takes what is used from the account.
  Result<void> Finish();

  VertexView view() const { return array_.view(); }
  FarVertices* far() const { return far_.get(); }
  Result<bool> Visit(const std::function<void(const VertexView&)>& visit) const;

  bool failed() const { return failure_.has_value(); }
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(*failure_); }

 private:
  // True if these would turn floats into doubles that do not fit beside them.
  bool WouldNotWiden(double x, double y, double z) const {
    return !array_.is_double() && array_.bytes() > budget_ / 3 &&
           !(VertexArray::IsFloat(x) && VertexArray::IsFloat(y) && VertexArray::IsFloat(z));
  }
  bool Spill();
  bool TakeBudget();
  bool Fail(Error error) {
    failure_ = std::move(error);
    return false;
  }

  const std::string name_;
  const OpenOptions options_;
  std::uint64_t budget_, spill_at_;
  const bool limited_;
  VertexArray array_;
  MemoryShare share_;
  std::unique_ptr<ScratchVertices> spill_;
  std::uint64_t spilled_ = 0;
  std::unique_ptr<FarVertices> far_;
  std::optional<Error> failure_;
};

}  // namespace strata::io
