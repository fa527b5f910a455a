#include "io/text_scanner.h"

#include <algorithm>
#include <cstring>

namespace strata::io {
namespace {

constexpr std::size_t kWindow = std::size_t{1} << 16;
constexpr std::size_t kMaxLineLimit = std::size_t{1} << 30;
constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

const char* Find(std::string_view in, char c, std::size_t from = 0) {
  if (from >= in.size()) return nullptr;
  return static_cast<const char*>(std::memchr(in.data() + from, c, in.size() - from));
}

}  // namespace

TextScanner::TextScanner(ByteSource& source, std::size_t max_line_bytes)
    : source_(source),
      max_line_bytes_(std::min(max_line_bytes, kMaxLineLimit)),
      // Room for a line that is one byte too long and for its end.
      input_(source, std::max(kWindow, max_line_bytes_ + 4)) {}

bool TextScanner::Reject(const std::string& what, ErrorCode code) {
  failed_ = true;
  failure_ = {code, source_.name() + ": line " +
                        std::to_string(std::max<std::uint64_t>(number_, 1)) + ": " + what};
  return false;
}

Result<void> TextScanner::Seek(std::uint64_t offset, std::uint64_t line_number) {
  if (ends_ == Ends::kUnknown && offset > 0) {
    // The first line of the text tells how lines end, wherever reading begins.
    if (auto ok = Seek(0, 1); !ok) return ok;
    if (!DecideEnds()) return failure();
  }
  window_ = {};
  drained_ = swallow_lf_ = failed_ = false;
  terminated_ = true;
  next_number_ = line_number;
  return input_.Seek(offset);
}

// Brings more of the text into view; false on an error.
bool TextScanner::Refill() {
  const auto more = input_.Peek(window_.size() + 1);
  if (!more) {
    failed_ = true;
    failure_ = more.error();
    return false;
  }
  drained_ = more->size() == window_.size();
  window_ = *more;
  return true;
}

// Looks at the first line end of the text.
bool TextScanner::DecideEnds() {
  while (window_.size() < kByteOrderMark.size() && !drained_) {
    if (!Refill()) return false;
  }
  if (input_.offset() == 0 && window_.substr(0, kByteOrderMark.size()) == kByteOrderMark) {
    input_.Consume(kByteOrderMark.size());
    window_.remove_prefix(kByteOrderMark.size());
  }
  for (;;) {
    const std::size_t at = window_.find_first_of("\r\n");
    const bool decided = at != std::string_view::npos &&
                         (window_[at] == '\n' || at + 1 < window_.size() || drained_);
    if (decided) {
      const bool lone =
          window_[at] == '\r' && (at + 1 == window_.size() || window_[at + 1] != '\n');
      ends_ = lone ? Ends::kAny : Ends::kLf;
      return true;
    }
    // A first line that is too long is found out by whoever looks for its end.
    if (drained_ || window_.size() > max_line_bytes_ + 1) {
      if (drained_) ends_ = Ends::kLf;
      return true;
    }
    if (!Refill()) return false;
  }
}

const char* TextScanner::FindEnd(std::size_t from) const {
  const char* lf = Find(window_, '\n', from);
  if (ends_ != Ends::kAny) return lf;
  const char* last = lf == nullptr ? window_.data() + window_.size() : lf;
  const std::size_t start = std::min(from, static_cast<std::size_t>(last - window_.data()));
  const char* cr =
      Find(window_.substr(0, static_cast<std::size_t>(last - window_.data())), '\r', start);
  return cr != nullptr ? cr : lf;
}

void TextScanner::Take(std::size_t length, std::size_t with_end) {
  line_ = window_.substr(0, length);
  offset_ = input_.offset();
  number_ = next_number_++;
  input_.Consume(with_end);
  window_.remove_prefix(with_end);
}

// The next line, whatever the one before it was.
bool TextScanner::FindLine() {
  if (ends_ == Ends::kUnknown && !DecideEnds()) return false;
  std::size_t looked_at = 0;
  for (;;) {
    if (swallow_lf_ && !window_.empty()) {
      swallow_lf_ = false;
      if (window_.front() == '\n') {
        input_.Consume(1);
        window_.remove_prefix(1);
      }
    }
    const char* end = FindEnd(looked_at);
    std::size_t length =
        end == nullptr ? window_.size() : static_cast<std::size_t>(end - window_.data());
    looked_at = length;
    const bool cr_before = length > 0 && window_[length - 1] == '\r' && ends_ != Ends::kAny;
    if (length - (cr_before ? 1 : 0) > max_line_bytes_) {
      number_ = next_number_;
      return Reject("found a line of " + std::to_string(length) +
                    " bytes or more, expected at most " + std::to_string(max_line_bytes_));
    }
    if (end != nullptr) {
      terminated_ = true;
      swallow_lf_ = *end == '\r';
      Take(length - (cr_before ? 1 : 0), length + 1);
      return true;
    }
    if (drained_) {
      if (window_.empty()) return false;
      terminated_ = false;
      Take(length, length);
      return true;
    }
    if (!Refill()) return false;
  }
}

bool TextScanner::Next() { return !failed_ && FindLine(); }

bool TextScanner::JoinContinuations() {
  const auto continued = [](std::string_view text) {
    while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
    return !text.empty() && text.back() == '\\' && Find(text, '#') == nullptr;
  };
  if (!continued(line_)) return true;
  const std::uint64_t number = number_, offset = offset_;
  joined_ = line_;
  do {
    joined_.resize(joined_.rfind('\\'));
    joined_ += ' ';
    const bool found = FindLine();
    number_ = number, offset_ = offset;
    if (failed_) return false;
    if (!found)
      return Reject("found the end of the file behind a backslash, expected another line");
    if (joined_.size() + line_.size() > max_line_bytes_) {
      return Reject("found lines of " + std::to_string(joined_.size() + line_.size()) +
                    " bytes joined by backslashes, expected at most " +
                    std::to_string(max_line_bytes_));
    }
    joined_ += line_;
  } while (continued(line_));
  line_ = joined_;
  return true;
}

}  // namespace strata::io
