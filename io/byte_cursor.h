// Walking through an InputBuffer by pointer.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/result.h"
#include "io/byte_source.h"

namespace strata::io {

/// A read position in a stream of bytes. Costs a comparison as long as the window holds what is
/// asked for. Failures are kept, so that inner loops test a bool: once a call has returned false,
/// failure() says why and the cursor is spent.
class ByteCursor {
 public:
  explicit ByteCursor(InputBuffer& input) : input_(input) {}

  /// True if `n` bytes stand at data(). `n` must be at most kMost.
  bool Have(std::size_t n) { return n <= available() || Refill(n); }
  static constexpr std::size_t kMost = 4096;

  const char* data() const { return data_; }
  std::size_t available() const { return static_cast<std::size_t>(end_ - data_); }
  void Advance(std::size_t n) { data_ += n; }

  /// Passes over `n` bytes, which must exist.
  bool Skip(std::uint64_t n);

  std::uint64_t offset() const {
    return input_.offset() + static_cast<std::uint64_t>(data_ - begin_);
  }
  Result<void> Seek(std::uint64_t offset);
  /// InputBuffer::LimitAhead.
  void LimitAhead(std::uint64_t offset) { input_.LimitAhead(offset); }
  /// Passes over white space and zeros to the end of the source; anything else is kCorruptInput.
  Result<void> ExpectPaddingOnly();

  /// Notes that the data at offset() are wrong. Returns false.
  bool Reject(const std::string& what, ErrorCode code = ErrorCode::kCorruptInput);
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(failure_); }

 private:
  bool Refill(std::size_t n);
  // Loads at least min(n, what there is); false on a read error.
  bool Load(std::size_t n);

  InputBuffer& input_;
  const char *begin_ = nullptr, *data_ = nullptr, *end_ = nullptr;
  Error failure_;
};

}  // namespace strata::io
