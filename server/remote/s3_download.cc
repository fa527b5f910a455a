// Objects into files: what broke goes on where it broke, what is wrong is not kept.
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>

#include "core/run_context.h"
#include "io/output_place.h"
#include "io/sha256.h"
#include "server/remote/s3_client.h"

namespace strata::server {
namespace {

// Of one object, with progress between: a store that gives a byte at a time is given up, too.
constexpr int kMostTries = 1000;

std::optional<std::uint64_t> ParseCount(std::string_view text) {
  std::uint64_t count = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), count);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return count;
}

/// "bytes FIRST-LAST/SIZE"
struct ContentRange {
  std::uint64_t first = 0, last = 0, size = 0;
};
std::optional<ContentRange> ParseContentRange(std::string_view text) {
  constexpr std::string_view kUnit = "bytes ";
  if (!text.starts_with(kUnit)) return std::nullopt;
  text.remove_prefix(kUnit.size());
  const std::size_t dash = text.find('-');
  const std::size_t slash = text.find('/');
  if (dash == std::string_view::npos || slash == std::string_view::npos || slash < dash) {
    return std::nullopt;
  }
  const auto first = ParseCount(text.substr(0, dash));
  const auto last = ParseCount(text.substr(dash + 1, slash - dash - 1));
  const auto size = ParseCount(text.substr(slash + 1));
  if (!first || !last || !size || *last < *first || *size <= *last) return std::nullopt;
  return ContentRange{*first, *last, *size};
}

}  // namespace

/// One object on its way into a file or a string.
class S3Fetch {
 public:
  S3Fetch(S3Client& client, const S3Name& name, int fd, std::string* text, std::uint64_t max_bytes)
      : client_(client), name_(name), fd_(fd), text_(text), max_bytes_(max_bytes) {}

  Result<S3Object> Run() {
    Backoff backoff(client_.config_.max_attempts, client_.cancelled_);
    int restarts = 0, tries = 0;
    for (;;) {
      if (client_.cancelled()) return Cancelled();
      const std::uint64_t before = done_;
      std::optional<Error> error = TryOnce();
      if (!error) return object_;
      if (done_ > before) backoff.Reset();
      // An object that is replaced again and again must not keep us for ever.
      if (start_again_ && ++restarts > client_.config_.max_attempts) retry_ = false;
      if (start_again_) done_ = 0;
      if (++tries >= kMostTries) retry_ = false;
      if (retry_ && backoff.Wait(retry_after_)) continue;
      if (client_.cancelled()) return Cancelled();
      error->message += ", after " + std::to_string(done_) + " bytes";
      return tl::unexpected<Error>(std::move(*error));
    }
  }

 private:
  std::optional<Error> TryOnce() {
    retry_ = start_again_ = began_ = false;
    failed_.reset();
    retry_after_.reset();
    // Without a tag, nothing tells whether the rest would be of the same version.
    if ((done_ == 0 || object_.etag.empty()) && !StartOver()) return failed_;
    S3Client::Outcome outcome = client_.Try(MakeCall());
    if (failed_) return failed_;
    if (outcome.error) {
      retry_ = outcome.retry;
      retry_after_ = outcome.retry_after;
      // 412: another version is there now. 416: it is shorter, too.
      if (done_ > 0 && (outcome.answer.status == 412 || outcome.answer.status == 416)) {
        retry_ = start_again_ = true;
      }
      return outcome.error;
    }
    if (!began_ && !Begin(outcome.answer.status, outcome.answer.headers)) return failed_;
    return Check();
  }

  S3Client::Call MakeCall() {
    S3Client::Call call;
    call.name = name_;
    if (done_ > 0) {
      call.headers = {"range: bytes=" + std::to_string(done_) + '-',
                      "if-match: \"" + object_.etag + '"'};
    }
    call.begin = [this](int status, const auto& headers) { return Begin(status, headers); };
    call.sink = [this](std::string_view bytes) { return Take(bytes); };
    return call;
  }

  bool StartOver() {
    md5_ = io::Hasher(io::DigestKind::kMd5);
    if (text_ != nullptr) text_->clear();
    done_ = 0;
    const bool emptied = fd_ < 0 || (ftruncate(fd_, 0) == 0 && lseek(fd_, 0, SEEK_SET) == 0);
    return emptied || FailDisk(errno);
  }

  /// Looks at the head of an answer. False: `failed_` says why.
  bool Begin(int status, const std::map<std::string, std::string>& headers) {
    began_ = true;
    const auto header = [&](const char* name) {
      const auto found = headers.find(name);
      return found != headers.end() ? found->second : std::string();
    };
    const std::string etag = WithoutQuotes(header("etag"));
    const std::optional<std::uint64_t> length = ParseCount(header("content-length"));
    if (status == 206) {
      const auto range = ParseContentRange(header("content-range"));
      if (done_ == 0 || !range || range->first != done_) {
        return Refuse("the store sends another range than was asked for");
      }
      // Not every store minds If-Match.
      if (etag != object_.etag || range->size != object_.size) {
        retry_ = start_again_ = true;
        return Refuse("it was replaced while it was fetched");
      }
      return true;
    }
    if (!length) return Refuse("the store does not say how large it is");
    if (done_ > 0 && !StartOver()) return false;  // The store does not know ranges.
    object_ = {name_.key, *length, etag, header("last-modified")};
    is_md5_ = IsMd5Tag(etag, headers);
    if (object_.size > max_bytes_) {
      Refuse(std::to_string(object_.size) + " bytes, of which " + std::to_string(max_bytes_) +
             " are allowed");
      failed_->code = ErrorCode::kOverBudget;
      return false;
    }
    return true;
  }

  bool Take(std::string_view bytes) {
    if (bytes.size() > object_.size - done_) {
      return Refuse("the store sends more than the " + std::to_string(object_.size) +
                    " bytes that it announced");
    }
    if (fd_ >= 0) {
      std::uint64_t written = 0;
      if (const int error = io::WriteAll(fd_, bytes, written); error != 0) return FailDisk(error);
    } else {
      text_->append(bytes);
    }
    md5_.Update(bytes);
    done_ += bytes.size();
    return true;
  }

  std::optional<Error> Check() {
    if (done_ != object_.size) {
      retry_ = true;
      Refuse("the transfer ended early, of " + std::to_string(object_.size) + " bytes");
      return failed_;
    }
    const std::string md5 = is_md5_ ? md5_.HexDigest() : std::string();
    if (md5.empty() || md5 == object_.etag) return std::nullopt;
    retry_ = start_again_ = true;
    Refuse("what came has the MD5 " + md5 + ": expected " + object_.etag);
    return failed_;
  }

  bool Refuse(const std::string& why) {
    failed_ = Error{ErrorCode::kIo, name_.Shown() + ": " + why};
    return false;
  }

  bool FailDisk(int error) {
    Refuse("cannot write what is fetched at byte " + std::to_string(done_) + ": " +
           io::SystemReason(error));
    failed_->kind = &kLocalFile;
    return false;
  }

  S3Client& client_;
  const S3Name& name_;
  int fd_;             // -1: into text_.
  std::string* text_;  // Null: into fd_.
  std::uint64_t max_bytes_;
  S3Object object_;         // As the first answer described it.
  bool is_md5_ = false;     // Its tag.
  std::uint64_t done_ = 0;  // Bytes of it that are written.
  io::Hasher md5_{io::DigestKind::kMd5};
  // Of the present try:
  bool began_ = false;
  std::optional<Error> failed_;  // What was found here, not by the client.
  bool retry_ = false, start_again_ = false;
  std::optional<std::chrono::seconds> retry_after_;
};

Result<S3Object> S3Client::GetToFile(const S3Name& name, int fd, std::uint64_t max_bytes) {
  return S3Fetch(*this, name, fd, nullptr, max_bytes).Run();
}

Result<void> S3Client::ReadAt(const S3Name& name, std::uint64_t offset, std::span<char> out,
                              const std::string& etag) {
  if (out.empty()) return {};
  std::size_t done = 0;
  std::string refused;
  bool replaced = false;
  Call call;
  call.name = name;
  call.headers = {"range: bytes=" + std::to_string(offset) + '-' +
                  std::to_string(offset + out.size() - 1)};
  if (!etag.empty()) call.headers.push_back("if-match: \"" + etag + '"');
  call.begin = [&](int status, const auto& headers) {
    done = 0;
    // Not every store minds If-Match.
    const auto tag = headers.find("etag");
    replaced = !etag.empty() && tag != headers.end() && WithoutQuotes(tag->second) != etag;
    if (replaced) return false;
    const auto found = headers.find("content-range");
    const auto range =
        found != headers.end() ? ParseContentRange(found->second) : std::optional<ContentRange>();
    if (status == 206 && range && range->first == offset) return true;
    refused = "the store sends another range than was asked for";
    return false;
  };
  call.sink = [&](std::string_view bytes) {
    if (bytes.size() > out.size() - done) {
      refused = "the store sends more than was asked for";
      return false;
    }
    std::memcpy(out.data() + done, bytes.data(), bytes.size());
    done += bytes.size();
    return true;
  };
  std::string code;
  const Result<HttpAnswer> answer = Perform(call, &code);
  // 416: the version that is there is shorter, too.
  if (replaced || (!etag.empty() && (code == "PreconditionFailed" || code == "InvalidRange"))) {
    return Fail(ErrorCode::kConflict, name.Shown() + ": was replaced while it was read");
  }
  if (!refused.empty()) return Fail(ErrorCode::kIo, name.Shown() + ": " + refused);
  if (!answer) return Forward(answer);
  if (done == out.size()) return {};
  return Fail(ErrorCode::kIo, name.Shown() + ": " + std::to_string(out.size()) +
                                  " bytes from byte " + std::to_string(offset) +
                                  " wanted, the object ends after " + std::to_string(done));
}

Result<std::string> S3Client::Get(const S3Name& name, std::uint64_t max_bytes) {
  std::string text;
  const Result<S3Object> object = S3Fetch(*this, name, -1, &text, max_bytes).Run();
  if (!object) return Forward(object);
  return text;
}

}  // namespace strata::server
