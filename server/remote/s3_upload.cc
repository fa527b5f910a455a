// Objects out of files: in one request, or in parts that become an object only when all are there.
#include <curl/curl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <mutex>
#include <optional>
#include <thread>

#include "core/run_context.h"
#include "io/output_place.h"
#include "io/sha256.h"
#include "server/remote/s3_client.h"

namespace strata::server {
namespace {

constexpr std::uint64_t kLeastPart = std::uint64_t{8} << 20;
constexpr std::uint64_t kMostParts = 10'000;
// Putting the parts together takes a store minutes for large objects, in which it sends next to
// nothing.
constexpr int kCompletionSeconds = 900;
constexpr int kAbortSeconds = 10;

/// What a payload must arrive as.
struct Digests {
  std::string sha256, md5;
};

/// Of a text, or of a part of a file. Errors: kIo.
Result<Digests> DigestsOf(const S3Name& name, const Payload& payload) {
  io::Hasher sha256, md5(io::DigestKind::kMd5);
  const auto take = [&](std::span<const char> bytes) {
    sha256.Update(bytes);
    md5.Update(bytes);
  };
  if (payload.fd < 0) take(payload.text);
  std::vector<char> buffer(payload.fd < 0 ? 0 : 256 << 10);
  for (std::uint64_t done = 0; payload.fd >= 0 && done < payload.size;) {
    const auto want =
        static_cast<std::size_t>(std::min<std::uint64_t>(buffer.size(), payload.size - done));
    const ssize_t count =
        pread(payload.fd, buffer.data(), want, static_cast<off_t>(payload.offset + done));
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      const std::string why = count == 0 ? "the file ends" : io::SystemReason(errno);
      return Fail(ErrorCode::kIo,
                  name.Shown() + ": cannot read what is put there at byte " +
                      std::to_string(payload.offset + done) + ": " + why,
                  &kLocalFile);
    }
    take({buffer.data(), static_cast<std::size_t>(count)});
    done += static_cast<std::uint64_t>(count);
  }
  return Digests{sha256.HexDigest(), md5.HexDigest()};
}

/// Whether a store's tag contradicts the MD5 of what was sent.
bool Contradicts(const HttpAnswer& answer, const std::string& etag, const std::string& md5) {
  return IsMd5Tag(etag, answer.headers) && !md5.empty() && etag != md5;
}

/// "2026-01-31T12:00:00.000Z" in seconds since 1970.
std::optional<std::int64_t> ParseTime(const std::string& text) {
  std::tm parts{};
  if (strptime(text.c_str(), "%Y-%m-%dT%H:%M:%S", &parts) == nullptr) return std::nullopt;
  return timegm(&parts);
}

std::string BytesOfHex(std::string_view hex) {
  std::string bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2) {
    bytes += static_cast<char>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16));
  }
  return bytes;
}

}  // namespace

std::uint64_t S3Client::PartBytes(std::uint64_t size) {
  std::uint64_t part = kLeastPart;
  while ((size + part - 1) / part > kMostParts) part *= 2;
  return part;
}

Result<std::string> S3Client::PutFile(const S3Name& name, int fd, std::uint64_t size,
                                      std::uint64_t offset) {
  const Payload file = Payload::OfFile(fd, offset, size);
  return size <= kLeastPart ? PutWhole(name, file) : PutInParts(name, file);
}

Result<std::string> S3Client::Put(const S3Name& name, std::string_view bytes) {
  return PutWhole(name, Payload::Of(bytes));
}

Result<bool> S3Client::PutNew(const S3Name& name, std::string_view bytes) {
  std::string code;
  const auto put = PutWhole(name, Payload::Of(bytes), {"if-none-match: *"}, &code);
  if (put) return true;
  if (code == "PreconditionFailed") return false;
  if (code != "NotImplemented") return Forward(put);
  const auto replaced = Put(name, bytes);
  if (!replaced) return Forward(replaced);
  return true;
}

Result<std::string> S3Client::PutWhole(const S3Name& name, const Payload& payload,
                                       std::vector<std::string> headers, std::string* code) {
  const Result<Digests> digests = DigestsOf(name, payload);
  if (!digests) return Forward(digests);
  Call call;
  call.method = "PUT";
  call.name = name;
  call.headers = std::move(headers);
  call.payload = payload;
  call.payload_sha256 = digests->sha256;
  const Result<HttpAnswer> answer = Perform(call, code);
  if (!answer) return Forward(answer);
  std::string etag = WithoutQuotes(answer->Header("etag"));
  if (Contradicts(*answer, etag, digests->md5)) {
    return Fail(ErrorCode::kIo, name.Shown() + ": the store has the MD5 " + etag +
                                    " of what it got: expected " + digests->md5);
  }
  return etag;
}

Result<std::string> S3Client::PutInParts(const S3Name& name, const Payload& file) {
  Call begin;
  begin.method = "POST";
  begin.name = name;
  begin.query = {{"uploads", ""}};
  begin.headers = {"content-type: application/octet-stream"};
  const Result<HttpAnswer> answer = Perform(begin);
  if (!answer) return Forward(answer);
  const Result<std::string> id = ParseInitiated(answer->body);
  if (!id) return Fail(id.error().code, name.Shown() + ": " + id.error().message);
  const Result<void> logged = log_ != nullptr ? log_->Began(name, *id) : Result<void>();
  Result<std::string> etag =
      logged ? PutParts(name, *id, file) : Result<std::string>(Forward(logged));
  // Also when the job is cancelled: what stays costs its owner money.
  const bool ended = etag || AbortUpload(name, *id);
  if (ended && log_ != nullptr) log_->Ended(name, *id);
  return etag;
}

/// The parts of one upload, which several threads send.
struct S3Client::Parts {
  const S3Name& name;
  const std::string& id;
  const Payload& file;
  const std::uint64_t part_bytes;
  std::vector<std::string> etags, md5s;  // By part; each written by who has taken it.
  std::mutex mutex;
  std::size_t next = 0;        // Guarded by mutex.
  std::optional<Error> error;  // The first; guarded by mutex.
};

Result<void> S3Client::SendPart(Parts& parts, std::size_t index) {
  const std::uint64_t begin = index * parts.part_bytes;
  Call call;
  call.method = "PUT";
  call.name = parts.name;
  call.query = {{"partNumber", std::to_string(index + 1)}, {"uploadId", parts.id}};
  call.payload = Payload::OfFile(parts.file.fd, parts.file.offset + begin,
                                 std::min(parts.part_bytes, parts.file.size - begin));
  const Result<Digests> digests = DigestsOf(parts.name, call.payload);
  if (!digests) return Forward(digests);
  call.payload_sha256 = digests->sha256;
  const Result<HttpAnswer> answer = Perform(call);
  if (!answer) return Forward(answer);
  std::string etag = WithoutQuotes(answer->Header("etag"));
  if (etag.empty() || Contradicts(*answer, etag, digests->md5)) {
    return Fail(ErrorCode::kIo, parts.name.Shown() + ": the store's tag of part " +
                                    std::to_string(index + 1) + " is '" + etag + "': expected " +
                                    digests->md5);
  }
  parts.etags[index] = std::move(etag);
  parts.md5s[index] = BytesOfHex(digests->md5);
  return {};
}

void S3Client::SendParts(Parts& parts) {
  std::unique_lock lock(parts.mutex);
  while (!parts.error && parts.next < parts.etags.size()) {
    const std::size_t index = parts.next++;
    lock.unlock();
    const Result<void> sent = SendPart(parts, index);
    lock.lock();
    if (!sent && !parts.error) parts.error = sent.error();
  }
}

Result<std::string> S3Client::PutParts(const S3Name& name, const std::string& id,
                                       const Payload& file) {
  const std::uint64_t part_bytes = PartBytes(file.size);
  const auto count = static_cast<std::size_t>((file.size + part_bytes - 1) / part_bytes);
  Parts parts{name, id, file, part_bytes, {}, {}, {}, 0, {}};
  parts.etags.resize(count);
  parts.md5s.resize(count);
  int helpers = static_cast<int>(std::min<std::size_t>(count, kMostSenders)) - 1;
  {
    const std::lock_guard lock(mutex_);
    helpers = std::min(helpers, kMostHelpers - helpers_);
    helpers_ += helpers;
  }
  std::vector<std::thread> threads;
  threads.reserve(static_cast<std::size_t>(helpers));
  for (int i = 0; i < helpers; ++i) threads.emplace_back([this, &parts] { SendParts(parts); });
  SendParts(parts);
  for (std::thread& thread : threads) thread.join();
  {
    const std::lock_guard lock(mutex_);
    helpers_ -= helpers;
  }
  if (parts.error) return tl::unexpected<Error>(*std::move(parts.error));
  io::Hasher of_parts(io::DigestKind::kMd5);
  for (const std::string& md5 : parts.md5s) of_parts.Update(md5);
  return Complete(name, id, parts.etags, of_parts.HexDigest() + '-' + std::to_string(count),
                  file.size);
}

Result<std::string> S3Client::Complete(const S3Name& name, const std::string& id,
                                       const std::vector<std::string>& etags,
                                       const std::string& expected, std::uint64_t size) {
  const std::string body = WriteCompletion(etags);
  Call call;
  call.method = "POST";
  call.name = name;
  call.query = {{"uploadId", id}};
  call.headers = {"content-type: application/xml"};
  call.payload = Payload::Of(body);
  call.payload_sha256 = io::Sha256Hex(body);
  call.patience_seconds = kCompletionSeconds;
  Backoff backoff(config_.max_attempts, cancelled_);
  for (;;) {
    std::string code;
    const Result<HttpAnswer> answer = Perform(call, &code);
    if (!answer && code != "NoSuchUpload") return Forward(answer);
    if (!answer) {
      // The answer of a former try may have been lost, after it had done its work.
      const Result<S3Object> object = Head(name);
      if (object && object->etag == expected && object->size == size) return object->etag;
      return Forward(answer);
    }
    Result<std::string> etag = ParseCompleted(answer->body);
    if (etag) return etag;
    // "200 OK" is sent before the work is done; how that ended stands in the body.
    if (etag.error().code == ErrorCode::kIo && backoff.Wait(std::nullopt)) continue;
    if (cancelled()) return Cancelled();
    return Fail(etag.error().code, name.Shown() + ": the store did not put the parts together: " +
                                       WithoutSecrets(etag.error().message));
  }
}

Result<void> S3Client::AbortUpload(const S3Name& name, const std::string& id) {
  Call call;
  call.method = "DELETE";
  call.name = name;
  call.query = {{"uploadId", id}};
  call.even_if_cancelled = true;
  call.patience_seconds = kAbortSeconds;
  std::string code;
  const Result<HttpAnswer> answer = Perform(call, &code);
  if (answer || code == "NoSuchUpload") return {};
  return Forward(answer);
}

Result<S3Uploads> S3Client::ListUploads(const S3Name& prefix) {
  S3Uploads found;
  UploadPage page;
  do {
    Call call;
    call.name.bucket = prefix.bucket;
    call.about = prefix.Shown();
    call.query = {{"uploads", ""}, {"encoding-type", "url"}, {"prefix", prefix.key}};
    if (!page.next_key.empty()) {
      call.query.emplace_back("key-marker", page.next_key);
      call.query.emplace_back("upload-id-marker", page.next_id);
    }
    const Result<HttpAnswer> answer = Perform(call);
    if (!answer) return Forward(answer);
    Result<UploadPage> next = ParseUploadPage(answer->body);
    if (!next) return Fail(next.error().code, prefix.Shown() + ": " + next.error().message);
    if (!next->next_key.empty() && next->next_key == page.next_key &&
        next->next_id == page.next_id) {
      return Fail(ErrorCode::kCorruptInput,
                  prefix.Shown() + ": the store's list of uploads does not advance");
    }
    found.now = curl_getdate(answer->Header("date").c_str(), nullptr);
    page = std::move(*next);
    for (S3Upload& upload : page.uploads) {
      if (upload.key.starts_with(prefix.key)) found.uploads.push_back(std::move(upload));
    }
  } while (!page.next_key.empty());
  return found;
}

Result<int> S3Client::AbortStaleUploads(const S3Name& prefix, std::chrono::seconds age) {
  const Result<S3Uploads> found = ListUploads(prefix);
  if (!found && found.error().code == ErrorCode::kUnsupported) return 0;
  if (!found) return Forward(found);
  int aborted = 0;
  for (const S3Upload& upload : found->uploads) {
    const std::optional<std::int64_t> began = ParseTime(upload.initiated);
    if (found->now < 0 || !began || found->now - *began <= age.count()) continue;
    const Result<void> done = AbortUpload({prefix.bucket, upload.key}, upload.id);
    if (!done) return Forward(done);
    ++aborted;
  }
  return aborted;
}

}  // namespace strata::server
