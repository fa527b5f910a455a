#include "io/byte_cursor.h"

namespace strata::io {

bool ByteCursor::Load(std::size_t n) {
  input_.Consume(static_cast<std::size_t>(data_ - begin_));
  begin_ = data_ = end_ = nullptr;
  auto window = input_.Peek(n);
  if (!window) {
    failure_ = window.error();
    return false;
  }
  begin_ = data_ = window->data();
  end_ = begin_ + window->size();
  return true;
}

bool ByteCursor::Refill(std::size_t n) {
  if (!Load(n)) return false;
  if (available() >= n) return true;
  return Reject("the file ends after " + std::to_string(available()) + " more bytes, expected " +
                std::to_string(n));
}

bool ByteCursor::Skip(std::uint64_t n) {
  if (n <= available()) {
    data_ += n;
    return true;
  }
  const std::uint64_t from = offset(), target = from + n;
  if (target < from) return Reject("expected more data than any file can hold");
  // A seek does not tell whether the place exists: reading the byte before it does.
  if (auto ok = Seek(target - 1); !ok) {
    failure_ = ok.error();
    return false;
  }
  if (!Load(1)) return false;
  if (available() < 1) {
    return Reject("the file ends here or before, expected " + std::to_string(n) +
                  " bytes from byte " + std::to_string(from) + " on");
  }
  Advance(1);
  return true;
}

Result<void> ByteCursor::Seek(std::uint64_t offset) {
  begin_ = data_ = end_ = nullptr;
  return input_.Seek(offset);
}

Result<void> ByteCursor::ExpectPaddingOnly() {
  for (;;) {
    if (!Load(1)) return failure();
    if (available() == 0) return {};
    const auto is_padding = [](char c) {
      return c == '\0' || c == ' ' || (c >= '\t' && c <= '\r');
    };
    data_ = std::find_if_not(data_, end_, is_padding);
    if (data_ != end_) {
      Reject("found more data, expected the end of the file after all that was announced");
      return failure();
    }
  }
}

bool ByteCursor::Reject(const std::string& what, ErrorCode code) {
  failure_ = {code, input_.source().name() + ": byte " + std::to_string(offset()) + ": " + what};
  return false;
}

}  // namespace strata::io
