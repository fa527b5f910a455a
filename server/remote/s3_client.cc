#include "server/remote/s3_client.h"

#include <curl/curl.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <ctime>

#include "core/run_context.h"
#include "io/quote.h"
#include "io/sha256.h"

namespace strata::server {
namespace {

// Of a listing: more pages than any bucket has, fewer than for ever.
constexpr int kMaxPages = 1'000'000;

bool IsRetryStatus(int status) {
  return status == 408 || status == 429 || (status >= 500 && status != 501);
}

/// Refusals that other statuses carry and that pass.
bool IsRetryCode(std::string_view code) {
  return code == "RequestTimeout" || code == "SlowDown" || code == "InternalError" ||
         code == "OperationAborted" || code == "ConditionalRequestConflict";
}

ErrorCode CodeOf(int status) {
  switch (status) {
    case 401:
    case 403:
    case 404:
      return ErrorCode::kNotFound;
    case 405:
    case 501:
      return ErrorCode::kUnsupported;
    case 409:
    case 412:
      return ErrorCode::kConflict;
    default:
      return ErrorCode::kIo;
  }
}

/// By how many seconds this machine's clock is ahead of the store's; nothing if it does not say.
std::optional<std::int64_t> ClockAhead(const HttpAnswer& answer) {
  const std::time_t theirs = curl_getdate(answer.Header("date").c_str(), nullptr);
  if (theirs == -1) return std::nullopt;
  return static_cast<std::int64_t>(std::time(nullptr) - theirs);
}

std::optional<std::chrono::seconds> RetryAfter(const HttpAnswer& answer) {
  const std::string text = answer.Header("retry-after");
  if (text.empty()) return std::nullopt;
  std::int64_t seconds = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seconds);
  if (error != std::errc() || end != text.data() + text.size()) {
    const std::time_t until = curl_getdate(text.c_str(), nullptr);
    if (until == -1) return std::nullopt;
    seconds = until - std::time(nullptr);
  }
  return std::chrono::seconds(std::max<std::int64_t>(seconds, 0));
}

std::string ClockHint(const HttpAnswer& answer, std::string_view code) {
  const std::optional<std::int64_t> ahead = ClockAhead(answer);
  const bool far = ahead && (*ahead > 300 || *ahead < -300);
  if (!far && code != "RequestTimeTooSkewed") return {};
  std::string hint = "; this machine's clock and the store's differ";
  if (!far) return hint + ": set it right";
  const std::int64_t seconds = *ahead > 0 ? *ahead : -*ahead;
  return hint + " by " + std::to_string(seconds) + " s (this one is " +
         (*ahead > 0 ? "ahead" : "behind") + "): set it right";
}

std::string KeyHint(std::string_view code, int status) {
  if (code == "InvalidAccessKeyId") return "; check AWS_ACCESS_KEY_ID or the profile";
  if (code == "SignatureDoesNotMatch") return "; check AWS_SECRET_ACCESS_KEY or the profile";
  if (code == "ExpiredToken" || code == "InvalidToken") return "; check AWS_SESSION_TOKEN";
  if (status == 401 || status == 403) return "; the credentials may not do this";
  return {};
}

/// A store's text in a message: one line, no control characters, not without end.
std::string OneLine(std::string_view text) {
  std::string line;
  for (const char c : text.substr(0, 300)) {
    line += static_cast<unsigned char>(c) < ' ' || c == 0x7F ? ' ' : c;
  }
  return line;
}

void ReplaceAll(std::string& text, const std::string& what, std::string_view with) {
  if (what.empty()) return;
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += with.size()) {
    text.replace(at, what.size(), with);
  }
}

S3Object ObjectOf(const S3Name& name, const HttpAnswer& answer) {
  S3Object object{name.key, 0, WithoutQuotes(answer.Header("etag")),
                  answer.Header("last-modified")};
  const std::string size = answer.Header("content-length");
  std::from_chars(size.data(), size.data() + size.size(), object.size);
  return object;
}

}  // namespace

S3Client::S3Client(S3Config config, std::function<bool()> cancelled, UploadLog* log)
    : config_(std::move(config)),
      cancelled_(std::move(cancelled)),
      log_(log),
      pool_(config_, cancelled_) {}

std::string S3Client::RegionOf(const std::string& bucket) {
  const std::lock_guard lock(mutex_);
  const auto found = regions_.find(bucket);
  return found != regions_.end() ? found->second : config_.region;
}

std::string S3Client::UrlOf(const Call& call, const std::string& region) const {
  std::string base = config_.endpoint;
  if (base.empty()) {
    base = "https://s3." + region + ".amazonaws.com" + (region.starts_with("cn-") ? ".cn" : "");
  }
  // A name with dots is not covered by the certificate for one label.
  const std::string& bucket = call.name.bucket;
  const bool in_host = config_.virtual_hosts && bucket.find('.') == std::string::npos;
  std::string url =
      in_host ? base.insert(base.find("://") + 3, bucket + '.') + '/' : base + '/' + bucket + '/';
  url += PercentEncode(call.name.key, true);
  const std::string query = EncodeQuery(call.query);
  return query.empty() ? url : url + '?' + query;
}

HttpAnswer S3Client::Send(const Call& call, const std::string& region, const std::string& url) {
  static const std::string kNothing = io::Sha256Hex({});
  HttpRequest request{call.method,
                      url,
                      region,
                      call.headers,
                      call.payload,
                      call.patience_seconds,
                      call.even_if_cancelled,
                      call.sink,
                      call.begin};
  // libcurl 7.88 signs every header it is given; this one S3 demands, and it does not add it.
  request.headers.push_back("x-amz-content-sha256: " +
                            (call.payload_sha256.empty() ? kNothing : call.payload_sha256));
  if (!config_.session_token.empty()) {
    request.headers.push_back("x-amz-security-token: " + config_.session_token);
  }
  return pool_.Exchange(request);
}

std::string S3Client::OtherRegion(const HttpAnswer& answer, const std::string& region) const {
  if (answer.status < 300 || answer.status > 400) return {};
  std::string other = answer.Header("x-amz-bucket-region");
  if (other.empty()) other = ParseRefusal(answer.body).region;
  const bool plain = !other.empty() && other.size() <= 64 && std::ranges::all_of(other, [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-';
  });
  return plain && other != region ? other : std::string();
}

std::string S3Client::OtherUrl(const HttpAnswer& answer, const std::string& url) const {
  if (answer.status != 301 && answer.status != 302 && answer.status != 307 &&
      answer.status != 308) {
    return {};
  }
  const std::string location = answer.Header("location");
  const std::size_t path = location.find('/', location.find("://") + 3);
  const std::string origin = location.substr(0, path);
  // What was asked for over https is not sent in the clear because somebody says so.
  const bool downgrade = url.starts_with("https://") && !location.starts_with("https://");
  const bool fine = location.find("://") != std::string::npos && path != std::string::npos &&
                    !downgrade && WhyNotAnEndpoint(origin, config_.allow_http).empty();
  return fine ? location : std::string();
}

HttpAnswer S3Client::SendFollowing(const Call& call) {
  const std::string region = RegionOf(call.name.bucket);
  const std::string url = UrlOf(call, region);
  HttpAnswer answer = Send(call, region, url);
  if (!answer.failure.empty()) return answer;
  if (const std::string other = OtherRegion(answer, region); !other.empty()) {
    {
      const std::lock_guard lock(mutex_);
      regions_[call.name.bucket] = other;
    }
    return Send(call, other, UrlOf(call, other));
  }
  if (const std::string other = OtherUrl(answer, url); !other.empty()) {
    return Send(call, region, other);
  }
  return answer;
}

std::string S3Client::WithoutSecrets(std::string text) const {
  ReplaceAll(text, config_.secret_key, "***");
  ReplaceAll(text, config_.session_token, "***");
  ReplaceAll(text, config_.access_key, "***");
  return text;
}

Error S3Client::Describe(const Call& call, const HttpAnswer& answer,
                         const S3Refusal& refusal) const {
  std::string what = "the store answered " + std::to_string(answer.status);
  if (!refusal.code.empty()) what += " " + OneLine(refusal.code);
  if (!refusal.message.empty()) what += " (" + OneLine(refusal.message) + ")";
  if (answer.status == 404 && refusal.code != "NoSuchBucket" && call.method != "PUT") {
    what = refusal.code == "NoSuchUpload" ? "the store knows no such upload" : "no such object";
  }
  if (answer.status >= 300 && answer.status < 400) what += ", a redirect that leads nowhere";
  what += KeyHint(refusal.code, answer.status);
  if (answer.status == 403 || answer.status == 400) what += ClockHint(answer, refusal.code);
  return {CodeOf(answer.status), call.Shown() + ": " + WithoutSecrets(what)};
}

S3Client::Outcome S3Client::Judge(const Call& call, HttpAnswer answer) const {
  Outcome outcome;
  if (answer.broken_off && !call.even_if_cancelled && cancelled()) {
    outcome.error = Cancelled().value();
  } else if (!answer.failure.empty()) {
    // Who finds an object damaged while it is sent can only break off.
    const bool began = answer.status == 200 || answer.status == 206;
    outcome.error =
        Error{ErrorCode::kIo, call.Shown() + ": " + WithoutSecrets(OneLine(answer.failure)),
              began ? &kStoreBusy : &kNoAnswer};
    outcome.retry = answer.transient;
  } else if (answer.status / 100 != 2) {
    const S3Refusal refusal = ParseRefusal(answer.body);
    // HEAD is answered without a body.
    const bool is_missing = refusal.code.empty() && answer.status == 404;
    outcome.code = is_missing ? "NoSuchKey" : refusal.code;
    outcome.error = Describe(call, answer, refusal);
    outcome.retry = IsRetryStatus(answer.status) || IsRetryCode(refusal.code);
    if (outcome.retry) outcome.error->kind = &kStoreBusy;
    outcome.retry_after = RetryAfter(answer);
  }
  outcome.answer = std::move(answer);
  return outcome;
}

S3Client::Outcome S3Client::Try(const Call& call) { return Judge(call, SendFollowing(call)); }

Result<HttpAnswer> S3Client::Perform(const Call& call, std::string* code) {
  const bool heed = !call.even_if_cancelled;
  Backoff backoff(config_.max_attempts, heed ? cancelled_ : std::function<bool()>());
  for (;;) {
    if (heed && cancelled()) return Cancelled();
    Outcome outcome = Try(call);
    if (!outcome.error) return std::move(outcome.answer);
    if (code != nullptr) *code = outcome.code;
    if (outcome.retry && backoff.Wait(outcome.retry_after)) continue;
    if (heed && cancelled()) return Cancelled();
    if (backoff.failed() > 1) {
      outcome.error->message += ", after " + std::to_string(backoff.failed()) + " tries";
    }
    return tl::unexpected<Error>(std::move(*outcome.error));
  }
}

Result<void> S3Client::List(const S3Name& prefix,
                            const std::function<Result<void>(S3Object)>& use) {
  std::string next, last;
  for (int page_number = 0; page_number < kMaxPages; ++page_number) {
    Call call;
    call.name.bucket = prefix.bucket;
    call.about = prefix.Shown();
    call.query = {{"list-type", "2"}, {"encoding-type", "url"}, {"prefix", prefix.key}};
    if (!next.empty()) call.query.emplace_back("continuation-token", next);
    const Result<HttpAnswer> answer = Perform(call);
    if (!answer) return Forward(answer);
    Result<ObjectPage> page = ParseObjectPage(answer->body);
    if (!page) return Fail(page.error().code, prefix.Shown() + ": " + page.error().message);
    for (S3Object& object : page->objects) {
      if (!object.key.starts_with(prefix.key)) {
        return Fail(ErrorCode::kCorruptInput, prefix.Shown() + ": the store lists " +
                                                  S3Name{prefix.bucket, object.key}.Shown() +
                                                  ", which does not begin so");
      }
      last = object.key;
      if (Result<void> used = use(std::move(object)); !used) return used;
    }
    if (page->next.empty()) return {};
    if (page->objects.empty() || page->next == next) break;
    next = std::move(page->next);
  }
  return Fail(ErrorCode::kCorruptInput, prefix.Shown() +
                                            ": the store's list does not advance after " +
                                            S3Name{prefix.bucket, last}.Shown());
}

Result<S3Object> S3Client::Head(const S3Name& name) {
  Call call;
  call.method = "HEAD";
  call.name = name;
  const Result<HttpAnswer> answer = Perform(call);
  if (!answer) return Forward(answer);
  return ObjectOf(name, *answer);
}

Result<std::optional<S3Object>> S3Client::Find(const S3Name& name) {
  Call call;
  call.method = "HEAD";
  call.name = name;
  std::string code;
  const Result<HttpAnswer> answer = Perform(call, &code);
  if (answer) return std::optional(ObjectOf(name, *answer));
  if (code == "NoSuchKey") return std::optional<S3Object>();
  return Forward(answer);
}

Result<void> S3Client::Delete(const S3Name& name) {
  Call call;
  call.method = "DELETE";
  call.name = name;
  std::string code;
  const Result<HttpAnswer> answer = Perform(call, &code);
  if (answer || code == "NoSuchKey") return {};
  return Forward(answer);
}

}  // namespace strata::server
