// Walking through text token by token.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "core/result.h"
#include "io/byte_source.h"

namespace strata::io {

/// A read position in text made of tokens and lines. Lines may be of any length, as only a token
/// must fit the window. Failures are kept, so that inner loops test a bool: once a call has
/// returned false, failure() says why and the cursor is spent.
class AsciiCursor {
 public:
  /// `newline` ends lines; '\n' goes with CRLF too, as '\r' then counts as blank.
  explicit AsciiCursor(InputBuffer& input, char newline = '\n');
  AsciiCursor(const AsciiCursor&) = delete;
  AsciiCursor& operator=(const AsciiCursor&) = delete;

  std::uint64_t offset() const { return base_ + static_cast<std::uint64_t>(data_ - begin_); }
  std::uint64_t line() const { return line_; }
  Result<void> Seek(std::uint64_t offset, std::uint64_t line);

  /// Passes over blank lines; true if a token stands there, false at the end or on a read error.
  bool NextRow();
  /// True if the file ended, which is how NextRow returns false without a failure.
  bool at_end() const { return in_tail_ && data_ >= soft_end_; }
  /// True if no token is left on the line.
  bool AtLineEnd() { return SkipBlanks() && IsNewline(*data_); }
  /// The same, and anything else is an error.
  bool ExpectLineEnd();
  /// Passes over the rest of the line, but not over its end.
  bool SkipLine();

  /// Each takes the next token of the line; what is missing or not such a number is an error.
  bool ReadInteger(std::int64_t& value, std::int64_t least, std::int64_t most);
  /// Correctly rounded; "nan" and "inf" are numbers, digits beyond the type's range are not.
  bool ReadFloat(float& value);
  bool ReadDouble(double& value);
  bool SkipToken();
  /// The next token, at most kMargin bytes, to be compared: does not consume. Empty at a line end.
  std::string_view PeekToken();
  void Advance(std::size_t n) { data_ += n; }

  /// Notes that the data at this line are wrong: "found <next token>, <expected>". Returns false.
  bool Reject(const std::string& expected);
  /// The same in other words: "<what>".
  bool Fault(const std::string& what, ErrorCode code = ErrorCode::kCorruptInput);
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(failure_); }

  /// What may be looked at from the start of a token on without asking.
  static constexpr std::size_t kMargin = 1024;

 private:
  enum : std::uint8_t { kInk, kBlank, kNewline };
  bool IsNewline(char c) const { return kinds_[static_cast<unsigned char>(c)] == kNewline; }
  bool IsBlank(char c) const { return kinds_[static_cast<unsigned char>(c)] == kBlank; }
  bool IsInk(char c) const { return kinds_[static_cast<unsigned char>(c)] == kInk; }

  // To the next token or line end, which then stands at data_ with kMargin bytes to look at.
  bool SkipBlanks() {
    for (;;) {
      while (data_ < soft_end_ && IsBlank(*data_)) ++data_;
      if (data_ < soft_end_ || in_tail_) return true;
      if (!Refill()) return false;
    }
  }
  bool Refill();
  bool RejectInteger(std::int64_t least, std::int64_t most);
  template <class Number>
  bool ReadReal(Number& value);

  InputBuffer& input_;
  char newline_;
  std::uint8_t kinds_[256] = {};
  // The bytes in view: the input's window, or at the end of the input a copy of its last bytes
  // with line ends behind them, so that scanning a token needs no test for the end.
  const char *begin_, *data_, *soft_end_, *end_;
  std::string tail_;
  bool in_tail_ = false;
  std::uint64_t base_ = 0;  // Offset of *begin_.
  std::uint64_t line_ = 1;
  Error failure_;
};

inline bool AsciiCursor::ReadInteger(std::int64_t& value, std::int64_t least, std::int64_t most) {
  if (!SkipBlanks()) return false;
  const char* p = data_;
  const bool negative = *p == '-';
  if (negative || *p == '+') ++p;
  const char* const first = p;
  std::uint64_t sum = 0;
  for (unsigned digit; (digit = static_cast<unsigned char>(*p) - unsigned{'0'}) <= 9; ++p) {
    if (p - first == 18) return RejectInteger(least, most);
    sum = sum * 10 + digit;
  }
  value = negative ? -static_cast<std::int64_t>(sum) : static_cast<std::int64_t>(sum);
  if (p == first || IsInk(*p) || value < least || value > most) return RejectInteger(least, most);
  data_ = p;
  return true;
}

}  // namespace strata::io
