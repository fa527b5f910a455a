// One signed HTTP request and its answer, by libcurl; connections are kept for the next one.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/remote/s3_config.h"

namespace strata::server {

/// What a request carries: a text, or a part of an open file. The owner keeps both alive.
struct Payload {
  std::string_view text;
  int fd = -1;  ///< -1: `text`.
  std::uint64_t offset = 0, size = 0;

  static Payload Of(std::string_view text) { return {text, -1, 0, text.size()}; }
  static Payload OfFile(int fd, std::uint64_t offset, std::uint64_t size) {
    return {{}, fd, offset, size};
  }
};

struct HttpRequest {
  std::string method;  ///< "GET", "HEAD", "PUT", "POST" or "DELETE".
  std::string url;     ///< Encoded, its query in the order of the signature.
  std::string region;  ///< For the signature.
  /// "name: value", each with a value: all of them are signed.
  std::vector<std::string> headers;
  Payload payload;           ///< Of PUT and POST.
  int patience_seconds = 0;  ///< Instead of the limit for stalled transfers; 0: that one holds.
  bool even_if_cancelled = false;  ///< What cleans up must be sent all the same.
  /// Gets the body of an answer 200 or 206 as it comes; false breaks off. Null: kept in the answer.
  std::function<bool(std::string_view)> sink;
  /// Gets the headers of such an answer before its body; false breaks off. Null: not asked.
  std::function<bool(int status, const std::map<std::string, std::string>& headers)> begin;
};

/// What came back.
struct HttpAnswer {
  int status = 0;                              ///< 0: none came.
  std::map<std::string, std::string> headers;  ///< Names in small letters.
  std::string body;                            ///< What no sink took; at most 16 MiB.
  /// Why the exchange did not come to its end, in words; empty: it did.
  std::string failure;
  bool transient = false;   ///< The failure is one that another try may not meet.
  bool broken_off = false;  ///< By `sink`, `begin` or a cancelled job.

  /// A header's value, or empty.
  std::string Header(const std::string& name) const;
};

/// Sends requests, each over a connection of its own that stays open for the next one. Signs them
/// with the keys of `config` (AWS Signature Version 4, service "s3"). Follows no redirect.
///
/// Threads: any, each of which waits for its own exchange. Memory: a few 10 KiB a connection, and
/// the body of one answer.
class HttpPool {
 public:
  /// `cancelled` is asked about once a second and when bytes move; must outlive the pool.
  HttpPool(const S3Config& config, std::function<bool()> cancelled);
  ~HttpPool();
  HttpPool(const HttpPool&) = delete;
  HttpPool& operator=(const HttpPool&) = delete;

  HttpAnswer Exchange(const HttpRequest& request);

 private:
  class Connection;
  std::unique_ptr<Connection> Take();
  void GiveBack(std::unique_ptr<Connection> connection);

  S3Config config_;
  std::function<bool()> cancelled_;
  std::mutex mutex_;
  std::vector<std::unique_ptr<Connection>> idle_;  // Guarded by mutex_.
};

}  // namespace strata::server
