// The vertices of an indexed mesh on disk.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/scratch.h"

namespace strata::io {

/// Vertices that are read a run at a time. Threads: one at a time.
class VertexFile {
 public:
  virtual ~VertexFile() = default;

  virtual std::uint64_t size() const = 0;
  /// Whether Load gives doubles rather than floats; does not change once loading has begun.
  virtual bool is_double() const = 0;
  std::size_t vertex_bytes() const { return 3 * (is_double() ? sizeof(double) : sizeof(float)); }
  /// Fills `out`, a multiple of vertex_bytes(), with the vertices from number `first` on, packed as
  /// x0,y0,z0,x1,…. Precondition: they exist. Errors: kIo.
  virtual Result<void> Load(std::uint64_t first, std::span<char> out) = 0;
};

/// Vertices that were written to scratch space, in single precision for as long as that loses
/// nothing. Memory: small fixed buffers.
class ScratchVertices : public VertexFile {
 public:
  explicit ScratchVertices(ScratchFolder& scratch) : scratch_(scratch) {}

  /// Appends all of `vertices`. Errors: kIo.
  Result<void> Append(const VertexView& vertices);

  std::uint64_t size() const override { return size_; }
  bool is_double() const override { return is_double_; }
  Result<void> Load(std::uint64_t first, std::span<char> out) override;

 private:
  Result<void> AppendWidened(std::span<const float> xyz);
  Result<void> TurnIntoDoubles();

  ScratchFolder& scratch_;
  std::unique_ptr<ScratchFile> file_;
  std::uint64_t size_ = 0;
  bool is_double_ = false;
};

}  // namespace strata::io
