// Walking through text line by line.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "core/result.h"
#include "io/byte_source.h"

namespace strata::io {

/// Hands out the lines of a text, numbered from 1.
///
/// Lines end with LF or CRLF, unless the first line of the text ends with a lone CR: then CR, LF
/// and CRLF all end lines. The last line need not be ended. A byte order mark at the start is
/// dropped; no other byte has a meaning here, NUL included. Memory: a window somewhat larger than
/// the longest line allowed, 64 KiB at least. Failures are kept, so that loops test a bool: once a
/// call has returned false, failed() tells the end of the text from an error.
class TextScanner {
 public:
  /// Lines above `max_line_bytes`, without their end, are refused. `source` must outlive the
  /// scanner.
  TextScanner(ByteSource& source, std::size_t max_line_bytes);

  /// Goes to the next line; false at the end of the text or on an error.
  bool Next();
  /// If the line ends in a backslash, blanks behind it aside, appends the next line in its place,
  /// and so on; all of it together must be within the limit. A backslash behind a `#` is part of a
  /// comment. False on an error; a text that ends with the backslash is one.
  bool JoinContinuations();

  /// The line without its end. Valid until the next call that is not const.
  std::string_view line() const { return line_; }
  /// The line's number; the first one's if several were joined.
  std::uint64_t line_number() const { return number_; }
  /// Where the line starts, and where the next one does, in the unpacked text.
  std::uint64_t line_offset() const { return offset_; }
  std::uint64_t next_offset() const { return input_.offset(); }
  std::uint64_t next_line_number() const { return next_number_; }
  /// False if the text ended before the line did.
  bool terminated() const { return terminated_; }

  /// Goes to `offset`, where line `line_number` starts.
  Result<void> Seek(std::uint64_t offset, std::uint64_t line_number);

  /// Somebody else moved the source. Only Seek may follow.
  void Forget() { input_.Forget(); }

  bool failed() const { return failed_; }
  /// Precondition: failed().
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(failure_); }
  /// An error at this line: "<name>: line <number>: <what>". Keeps it, returns false.
  bool Reject(const std::string& what, ErrorCode code = ErrorCode::kCorruptInput);

 private:
  enum class Ends : std::uint8_t { kUnknown, kLf, kAny };

  bool FindLine();
  bool Refill();
  bool DecideEnds();
  const char* FindEnd(std::size_t from) const;
  void Take(std::size_t length, std::size_t with_end);

  ByteSource& source_;
  std::size_t max_line_bytes_;
  InputBuffer input_;
  Ends ends_ = Ends::kUnknown;
  std::string_view window_;  // What is in view from the next line's start on.
  bool drained_ = false;     // Nothing follows the window.
  bool swallow_lf_ = false;  // The last line ended with a CR, whose LF may follow.

  std::string_view line_;
  std::string joined_;
  std::uint64_t number_ = 0, next_number_ = 1, offset_ = 0;
  bool terminated_ = true, failed_ = false;
  Error failure_;
};

/// True for what separates tokens within a line.
inline bool IsBlank(char c) { return c == ' ' || (c >= '\t' && c <= '\r' && c != '\n'); }
/// The first character at or behind `p` that is not blank.
inline const char* SkipBlanks(const char* p, const char* last) {
  while (p < last && IsBlank(*p)) ++p;
  return p;
}
/// The characters from `p` to the next blank: for messages.
inline std::string_view TokenAt(const char* p, const char* last) {
  const char* end = p;
  while (end < last && !IsBlank(*end)) ++end;
  return {p, static_cast<std::size_t>(end - p)};
}

}  // namespace strata::io
