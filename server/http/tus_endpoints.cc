// /v1/uploads: resumable uploads as tus 1.0 has them (core, creation, expiration, checksum,
// termination). A finished upload is a model.
#include <array>
#include <charconv>
#include <ctime>
#include <optional>
#include <string>

#include "server/http/base64.h"
#include "server/http/handlers.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

constexpr const char* kVersionHeader = "1.0.0";

Headers TusHeaders() { return {{"Tus-Resumable", kVersionHeader}, {"Cache-Control", "no-store"}}; }

void RespondTusProblem(Exchange& exchange, const Problem& problem) {
  Headers headers = {{"Tus-Resumable", kVersionHeader}};
  if (problem.http_status == 412) headers.emplace_back("Tus-Version", kVersionHeader);
  exchange.RespondProblem(problem, headers);
}

std::optional<std::uint64_t> NumberOf(const std::string& text) {
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (text.empty() || error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return number;
}

/// The stores, if the client speaks this version.
Answer<StoredService*> Begin(Service& service, const Exchange& exchange) {
  if (const std::string found = exchange.header("Tus-Resumable"); found != kVersionHeader) {
    return Refuse(Refusal::kPrecondition,
                  "Tus-Resumable: found '" + found + "', expected " + kVersionHeader);
  }
  return service.stored();
}

/// As a date in HTTP is written: "Sun, 06 Nov 1994 08:49:37 GMT".
std::string HttpDate(Timestamp time) {
  const std::time_t seconds = ToMillis(time) / 1000;
  std::tm parts{};
  gmtime_r(&seconds, &parts);
  std::array<char, 64> text;
  return {text.data(),
          std::strftime(text.data(), text.size(), "%a, %d %b %Y %H:%M:%S GMT", &parts)};
}

/// The value of a key in "key base64,key base64"; empty if there is none.
Answer<std::string> MetadataOf(const std::string& metadata, std::string_view key) {
  std::string_view rest = metadata;
  while (!rest.empty()) {
    std::string_view pair = rest.substr(0, std::min(rest.find(','), rest.size()));
    rest.remove_prefix(std::min(pair.size() + 1, rest.size()));
    while (pair.starts_with(' ')) pair.remove_prefix(1);
    const std::size_t space = std::min(pair.find(' '), pair.size());
    if (pair.substr(0, space) != key) continue;
    auto value = DecodeBase64(pair.substr(std::min(space + 1, pair.size())));
    if (value) return *std::move(value);
    return Refuse(Refusal::kMalformed,
                  "Upload-Metadata: the value of " + std::string(key) + " is no base64");
  }
  return std::string();
}

Answer<NewUpload> NewUploadOf(const Exchange& exchange) {
  NewUpload upload;
  upload.metadata = exchange.header("Upload-Metadata");
  for (const char* const key : {"name", "filename"}) {
    if (!upload.model.empty()) break;
    auto name = MetadataOf(upload.metadata, key);
    if (!name) return Pass(name);
    upload.model = *std::move(name);
  }
  if (upload.model.empty()) {
    return Refuse(Refusal::kMalformed,
                  "Upload-Metadata: expected name or filename, the model's name in base64");
  }
  const std::string length = exchange.header("Upload-Length");
  const std::string deferred = exchange.header("Upload-Defer-Length");
  upload.length = NumberOf(length);
  const bool told = upload.length && deferred.empty();
  if (!told && !(length.empty() && deferred == "1")) {
    return Refuse(Refusal::kMalformed,
                  "expected either Upload-Length: BYTES or Upload-Defer-Length: 1");
  }
  return upload;
}

Answer<std::optional<UploadChecksum>> ChecksumOf(const Exchange& exchange) {
  const std::string text = exchange.header("Upload-Checksum");
  if (text.empty()) return std::nullopt;
  const std::size_t space = std::min(text.find(' '), text.size());
  const std::string kind = text.substr(0, space);
  const auto digest = DecodeBase64(std::string_view(text).substr(std::min(space + 1, text.size())));
  const bool sha1 = kind == "sha1" && digest && digest->size() == 20;
  const bool sha256 = kind == "sha256" && digest && digest->size() == 32;
  if (!sha1 && !sha256) {
    return Refuse(Refusal::kMalformed,
                  "Upload-Checksum: expected sha1 or sha256, and the digest in base64");
  }
  UploadChecksum checksum;
  checksum.kind = sha1 ? io::DigestKind::kSha1 : io::DigestKind::kSha256;
  for (const unsigned char byte : *digest) {
    checksum.hex += "0123456789abcdef"[byte >> 4];
    checksum.hex += "0123456789abcdef"[byte & 15];
  }
  return std::optional(std::move(checksum));
}

Headers StateHeaders(const UploadInfo& info) {
  Headers headers = TusHeaders();
  headers.emplace_back("Upload-Offset", std::to_string(info.offset));
  headers.emplace_back("Upload-Expires", HttpDate(info.expires));
  return headers;
}

/// A checksum that differs has a status of its own in tus.
Problem ProblemOfFinish(const Error& error) {
  Problem problem = ProblemOf(error);
  if (error.code == ErrorCode::kCorruptInput) problem.http_status = 460;
  return problem;
}

Answer<UploadInfo> Patch(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = Begin(service, exchange);
  if (!stored) return Pass(stored);
  if (exchange.header("Content-Type") != "application/offset+octet-stream") {
    return Refuse(Refusal::kMediaType, "Content-Type: expected application/offset+octet-stream");
  }
  const auto offset = NumberOf(exchange.header("Upload-Offset"));
  if (!offset) return Refuse(Refusal::kMalformed, "Upload-Offset: expected a number of bytes");
  const auto checksum = ChecksumOf(exchange);
  if (!checksum) return Pass(checksum);
  UploadStore& uploads = (*stored)->store().uploads();
  if (const std::string text = exchange.header("Upload-Length"); !text.empty()) {
    const auto length = NumberOf(text);
    if (!length) {
      return Refuse(Refusal::kMalformed,
                    "Upload-Length: found '" + text + "', expected a number of bytes");
    }
    if (const auto told = uploads.SetLength(id, *length); !told) return Refuse(told.error());
  }
  auto append = uploads.Append(id, *offset, *checksum);
  if (!append) return Refuse(append.error());
  const auto received = exchange.ReadBody(service.limits().body_bytes,
                                          [&append](std::string_view bytes) -> Answer<void> {
                                            if (auto written = append->Write(bytes); !written)
                                              return Refuse(written.error());
                                            return {};
                                          });
  if (!received) return Pass(received);  // What came stays, for the client to go on from.
  const auto info = append->Finish();
  if (!info) return tl::unexpected<Problem>(ProblemOfFinish(info.error()));
  return *info;
}

}  // namespace

void TusOptions(Service& service, Exchange& exchange, const std::string&) {
  exchange.Respond(
      204,
      {{"Tus-Resumable", kVersionHeader},
       {"Tus-Version", kVersionHeader},
       {"Tus-Extension", "creation,creation-defer-length,expiration,checksum,termination"},
       {"Tus-Checksum-Algorithm", "sha1,sha256"},
       {"Tus-Max-Size", std::to_string(service.limits().body_bytes)}},
      "");
}

void TusCreate(Service& service, Exchange& exchange, const std::string&) {
  const auto stored = Begin(service, exchange);
  if (!stored) return RespondTusProblem(exchange, stored.error());
  const auto upload = NewUploadOf(exchange);
  if (!upload) return RespondTusProblem(exchange, upload.error());
  const auto created = (*stored)->store().uploads().Create(*upload);
  if (!created) return RespondTusProblem(exchange, ProblemOf(created.error()));
  Headers headers = StateHeaders(*created);
  headers.emplace_back("Location", "/v1/uploads/" + created->id);
  exchange.Respond(201, headers, "");
}

void TusHead(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = Begin(service, exchange);
  if (!stored) return RespondTusProblem(exchange, stored.error());
  const auto info = (*stored)->store().uploads().Head(id);
  if (!info) return RespondTusProblem(exchange, ProblemOf(info.error()));
  Headers headers = StateHeaders(*info);
  if (info->length) {
    headers.emplace_back("Upload-Length", std::to_string(*info->length));
  } else {
    headers.emplace_back("Upload-Defer-Length", "1");
  }
  if (!info->metadata.empty()) headers.emplace_back("Upload-Metadata", info->metadata);
  exchange.Respond(200, headers, "");
}

void TusPatch(Service& service, Exchange& exchange, const std::string& id) {
  const auto info = Patch(service, exchange, id);
  if (!info) return RespondTusProblem(exchange, info.error());
  exchange.Respond(204, StateHeaders(*info), "");
}

void TusDelete(Service& service, Exchange& exchange, const std::string& id) {
  const auto stored = Begin(service, exchange);
  if (!stored) return RespondTusProblem(exchange, stored.error());
  const auto ended = (*stored)->store().uploads().Terminate(id);
  if (!ended) return RespondTusProblem(exchange, ProblemOf(ended.error()));
  exchange.Respond(204, TusHeaders(), "");
}

}  // namespace strata::server
