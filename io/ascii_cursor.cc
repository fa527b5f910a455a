#include "io/ascii_cursor.h"

#include <fast_float/fast_float.h>

#include <cmath>

#include "io/quote.h"

namespace strata::io {

AsciiCursor::AsciiCursor(InputBuffer& input, char newline) : input_(input), newline_(newline) {
  for (const char c : {' ', '\t', '\v', '\f', '\r', '\n'}) {
    kinds_[static_cast<unsigned char>(c)] = c == newline ? kNewline : kBlank;
  }
  begin_ = data_ = soft_end_ = end_ = tail_.data();
  base_ = input.offset();
}

Result<void> AsciiCursor::Seek(std::uint64_t offset, std::uint64_t line) {
  begin_ = data_ = soft_end_ = end_ = tail_.data();
  in_tail_ = false;
  base_ = offset;
  line_ = line;
  return input_.Seek(offset);
}

// Brings at least kMargin bytes from data_ on into view, or the tail.
bool AsciiCursor::Refill() {
  base_ += static_cast<std::uint64_t>(data_ - begin_);
  if (auto ok = input_.Seek(base_); !ok) {
    failure_ = ok.error();
    return false;
  }
  auto window = input_.Peek(2 * kMargin);
  if (!window) {
    failure_ = window.error();
    return false;
  }
  in_tail_ = window->size() < 2 * kMargin;
  std::size_t size = window->size();
  if (in_tail_) {
    tail_.assign(*window);
    tail_.append(kMargin + 1, newline_);
    begin_ = tail_.data();
  } else {
    begin_ = window->data();
    size -= kMargin;
  }
  data_ = begin_;
  soft_end_ = begin_ + size;
  end_ = soft_end_ + kMargin;
  return true;
}

bool AsciiCursor::NextRow() {
  for (;;) {
    if (!SkipBlanks() || at_end()) return false;
    if (!IsNewline(*data_)) return true;
    ++data_;
    ++line_;
  }
}

bool AsciiCursor::ExpectLineEnd() {
  return AtLineEnd() || (failure_.message.empty() && Reject("expected the end of the line"));
}

bool AsciiCursor::SkipLine() {
  for (;;) {
    while (data_ < soft_end_ && !IsNewline(*data_)) ++data_;
    if (data_ < soft_end_ || in_tail_) return true;
    if (!Refill()) return false;
  }
}

bool AsciiCursor::SkipToken() {
  if (!SkipBlanks()) return false;
  if (!IsInk(*data_)) return Reject("expected a value");
  for (;;) {
    while (data_ < end_ && IsInk(*data_)) ++data_;
    if (data_ < end_) return true;
    if (!Refill()) return false;
  }
}

std::string_view AsciiCursor::PeekToken() {
  if (!SkipBlanks()) return {};
  const char* p = data_;
  while (p - data_ < static_cast<std::ptrdiff_t>(kMargin) && IsInk(*p)) ++p;
  return {data_, static_cast<std::size_t>(p - data_)};
}

template <class Number>
bool AsciiCursor::ReadReal(Number& value) {
  if (!SkipBlanks()) return false;
  const char* first = data_;
  if (*first == '+' && first[1] != '-') ++first;
  const auto [stop, error] = fast_float::from_chars(first, data_ + kMargin, value);
  if (stop == first || IsInk(*stop)) return Reject("expected a number");
  if (std::isinf(value)) {
    const char c = *first == '-' ? first[1] : *first;
    if (c != 'i' && c != 'I') return Reject("expected a number in the type's range");
  }
  data_ = stop;
  return true;
}

bool AsciiCursor::ReadFloat(float& value) { return ReadReal(value); }
bool AsciiCursor::ReadDouble(double& value) { return ReadReal(value); }

bool AsciiCursor::RejectInteger(std::int64_t least, std::int64_t most) {
  return Reject("expected an integer from " + std::to_string(least) + " to " +
                std::to_string(most));
}

bool AsciiCursor::Reject(const std::string& expected) {
  const std::string_view token = PeekToken();
  const std::string found = at_end()        ? "the end of the file"
                            : token.empty() ? "the end of the line"
                                            : Quoted(token);
  return Fault("found " + found + ", " + expected);
}

bool AsciiCursor::Fault(const std::string& what, ErrorCode code) {
  failure_ = {code, input_.source().name() + ": line " + std::to_string(line_) + ": " + what};
  return false;
}

}  // namespace strata::io
