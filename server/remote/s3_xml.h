// The XML that stores answer with and want to get.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// What a store tells of one object.
struct S3Object {
  std::string key;
  std::uint64_t size = 0;  ///< In bytes.
  /// Of this version of the object, without quotes; a hex MD5 of its bytes where it was put in one
  /// piece and is not encrypted with a key of the customer's.
  std::string etag;
  std::string modified;  ///< As the store wrote it; may be empty.
};

/// An upload in parts that was begun and neither completed nor aborted.
struct S3Upload {
  std::string key, id;
  std::string initiated;  ///< "2026-01-31T12:00:00.000Z"
};

/// A page of ListObjectsV2.
struct ObjectPage {
  std::vector<S3Object> objects;
  std::string next;  ///< The token of the next page; empty: this was the last.
};
/// A page of ListMultipartUploads.
struct UploadPage {
  std::vector<S3Upload> uploads;
  std::string next_key, next_id;  ///< Where the next page begins; empty: this was the last.
};

/// What a refusal says of itself; empty where it says nothing, or is no XML.
struct S3Refusal {
  std::string code, message, region;
};

/// Entities beyond XML's own five and document types are not looked at, so that nothing expands.
/// Errors: kCorruptInput for what is not XML of that kind, or contradicts itself.
Result<ObjectPage> ParseObjectPage(std::string_view xml);
Result<UploadPage> ParseUploadPage(std::string_view xml);
/// The id of a new upload.
Result<std::string> ParseInitiated(std::string_view xml);
/// The ETag of a completed upload, without quotes. A store may say 200 and report an error in the
/// body: that is kIo.
Result<std::string> ParseCompleted(std::string_view xml);
S3Refusal ParseRefusal(std::string_view xml);

/// The body that completes an upload of parts 1, 2, … with these ETags.
std::string WriteCompletion(const std::vector<std::string>& etags);

/// An ETag without its quotes.
std::string WithoutQuotes(std::string_view etag);
/// Whether an ETag is the MD5 of the object's bytes: it looks like one, and the headers of the same
/// answer do not name an encryption whose tags look so and mean nothing.
bool IsMd5Tag(std::string_view etag, const std::map<std::string, std::string>& headers);

}  // namespace strata::server
