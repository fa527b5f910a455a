#include "server/remote/s3_xml.h"

#include <charconv>
#include <pugixml.hpp>

#include "io/quote.h"
#include "server/remote/s3_name.h"

namespace strata::server {
namespace {

tl::unexpected<Error> FailAnswer(const std::string& what) {
  return Fail(ErrorCode::kCorruptInput, "the store's answer " + what);
}

/// Keys may consist of blanks, which are kept.
bool Load(pugi::xml_document& document, std::string_view xml) {
  return static_cast<bool>(document.load_buffer(
      xml.data(), xml.size(), pugi::parse_default | pugi::parse_ws_pcdata, pugi::encoding_utf8));
}

/// The element named `root` of a document that `document` owns.
Result<pugi::xml_node> LoadRoot(pugi::xml_document& document, std::string_view xml,
                                const char* root) {
  if (!Load(document, xml)) return FailAnswer("is not XML: " + io::Quoted(xml));
  const pugi::xml_node node = document.child(root);
  if (!node) {
    return FailAnswer("is <" + std::string(document.document_element().name()).substr(0, 40) +
                      ">: expected <" + root + ">");
  }
  return node;
}

/// Whether keys in a listing are percent-encoded: asked for, but not every store does it.
bool IsEncoded(const pugi::xml_node& listing) {
  return std::string_view(listing.child_value("EncodingType")) == "url";
}

Result<std::string> KeyOf(const pugi::xml_node& entry, const char* name, bool encoded) {
  const std::string text = entry.child_value(name);
  return encoded ? PercentDecode(text) : Result<std::string>(text);
}

bool IsTruncated(const pugi::xml_node& listing) {
  return std::string_view(listing.child_value("IsTruncated")) == "true";
}

Result<S3Object> ParseObject(const pugi::xml_node& entry, bool encoded) {
  Result<std::string> key = KeyOf(entry, "Key", encoded);
  if (!key) return Forward(key);
  S3Object object{std::move(*key), 0, WithoutQuotes(entry.child_value("ETag")),
                  entry.child_value("LastModified")};
  const std::string_view size = entry.child_value("Size");
  const auto [end, error] = std::from_chars(size.data(), size.data() + size.size(), object.size);
  if (object.key.empty() || error != std::errc() || end != size.data() + size.size()) {
    return FailAnswer("lists an object " + io::Quoted(object.key) + " of size " + io::Quoted(size) +
                      ": expected a key and a number");
  }
  return object;
}

}  // namespace

std::string WithoutQuotes(std::string_view etag) {
  if (etag.starts_with('"')) etag.remove_prefix(1);
  if (etag.ends_with('"')) etag.remove_suffix(1);
  return std::string(etag);
}

bool IsMd5Tag(std::string_view etag, const std::map<std::string, std::string>& headers) {
  const auto encryption = headers.find("x-amz-server-side-encryption");
  const bool means_nothing =
      (encryption != headers.end() && encryption->second.starts_with("aws:kms")) ||
      headers.contains("x-amz-server-side-encryption-customer-algorithm");
  return !means_nothing && etag.size() == 32 &&
         etag.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

Result<ObjectPage> ParseObjectPage(std::string_view xml) {
  pugi::xml_document document;
  const Result<pugi::xml_node> root = LoadRoot(document, xml, "ListBucketResult");
  if (!root) return Forward(root);
  ObjectPage page;
  for (const pugi::xml_node& entry : root->children("Contents")) {
    Result<S3Object> object = ParseObject(entry, IsEncoded(*root));
    if (!object) return Forward(object);
    page.objects.push_back(std::move(*object));
  }
  if (!IsTruncated(*root)) return page;
  page.next = root->child_value("NextContinuationToken");
  if (page.next.empty()) return FailAnswer("is cut off and does not say where it goes on");
  return page;
}

Result<UploadPage> ParseUploadPage(std::string_view xml) {
  pugi::xml_document document;
  const Result<pugi::xml_node> root = LoadRoot(document, xml, "ListMultipartUploadsResult");
  if (!root) return Forward(root);
  UploadPage page;
  for (const pugi::xml_node& entry : root->children("Upload")) {
    Result<std::string> key = KeyOf(entry, "Key", IsEncoded(*root));
    if (!key) return Forward(key);
    page.uploads.push_back(
        {std::move(*key), entry.child_value("UploadId"), entry.child_value("Initiated")});
  }
  if (!IsTruncated(*root)) return page;
  Result<std::string> next = KeyOf(*root, "NextKeyMarker", IsEncoded(*root));
  if (!next) return Forward(next);
  page.next_key = std::move(*next);
  page.next_id = root->child_value("NextUploadIdMarker");
  if (page.next_key.empty()) return FailAnswer("is cut off and does not say where it goes on");
  return page;
}

Result<std::string> ParseInitiated(std::string_view xml) {
  pugi::xml_document document;
  const Result<pugi::xml_node> root = LoadRoot(document, xml, "InitiateMultipartUploadResult");
  if (!root) return Forward(root);
  std::string id = root->child_value("UploadId");
  if (id.empty()) return FailAnswer("names no upload");
  return id;
}

Result<std::string> ParseCompleted(std::string_view xml) {
  pugi::xml_document document;
  if (Load(document, xml) && document.child("Error")) {
    const S3Refusal refusal = ParseRefusal(xml);
    return Fail(ErrorCode::kIo, refusal.code + ": " + refusal.message);
  }
  const Result<pugi::xml_node> root = LoadRoot(document, xml, "CompleteMultipartUploadResult");
  if (!root) return Forward(root);
  return WithoutQuotes(root->child_value("ETag"));
}

S3Refusal ParseRefusal(std::string_view xml) {
  pugi::xml_document document;
  if (!Load(document, xml)) return {};
  const pugi::xml_node error = document.child("Error");
  return {error.child_value("Code"), error.child_value("Message"), error.child_value("Region")};
}

std::string WriteCompletion(const std::vector<std::string>& etags) {
  std::string xml = "<CompleteMultipartUpload xmlns=\"http://s3.amazonaws.com/doc/2006-03-01/\">";
  int number = 0;
  for (const std::string& etag : etags) {
    std::string safe;
    for (const char c : etag) {
      if (c == '&' || c == '<' || c == '>') {
        safe += "&#" + std::to_string(static_cast<int>(c)) + ';';
      } else {
        safe += c;
      }
    }
    xml += "<Part><PartNumber>" + std::to_string(++number) + "</PartNumber><ETag>\"" + safe +
           "\"</ETag></Part>";
  }
  return xml + "</CompleteMultipartUpload>";
}

}  // namespace strata::server
