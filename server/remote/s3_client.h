// Objects in S3-compatible stores: list, look at, fetch, put, delete.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/remote/backoff.h"
#include "server/remote/http_exchange.h"
#include "server/remote/s3_config.h"
#include "server/remote/s3_name.h"
#include "server/remote/s3_xml.h"

namespace strata::server {

/// Remembers uploads in parts from before their first part until they are complete or aborted, so
/// that those of a killed process can be found. Threads: any.
class UploadLog {
 public:
  virtual ~UploadLog() = default;
  virtual Result<void> Began(const S3Name& name, const std::string& id) = 0;
  virtual void Ended(const S3Name& name, const std::string& id) = 0;
};

/// Uploads that are under way or were left.
struct S3Uploads {
  std::vector<S3Upload> uploads;
  std::int64_t now = -1;  ///< Seconds since 1970 by the store's clock; -1: it did not say.
};

/// Kinds of errors (kIo). Every other comes of what the store answered, of this object or of all.
/// No answer, or none that can be understood: connections, TLS, names of hosts.
inline constexpr ErrorKind kNoAnswer;
/// The store answered that it cannot, for now: 408, 429, 5xx and the codes that say the same. Or it
/// began to send what was asked for, and broke off.
inline constexpr ErrorKind kStoreBusy;
/// A file of this machine could not be read or written: a full disk.
inline constexpr ErrorKind kLocalFile;

/// A client of one store. Every call does one thing and waits for it. Tries again what may pass
/// (broken connections, 408, 429, 5xx, SlowDown), with growing pauses and `Retry-After`, at most
/// `max_attempts` times; goes once to where the store redirects, signed anew.
///
/// Threads: any number of calls at once, each with a connection of its own. Memory: at most one
/// answer of 16 MiB a call; objects pass through buffers of 256 KiB.
/// Errors of all: kNotFound (no such object or bucket, or the keys may not: which, says the
/// message), kIo (the store or the way to it), kCorruptInput (an answer that is none), kCancelled.
/// Every message begins with the object's address; none holds a key or token.
class S3Client {
 public:
  /// `cancelled` is asked often, from any thread, and must outlive the client; empty: never. `log`
  /// may be null.
  explicit S3Client(S3Config config, std::function<bool()> cancelled = {},
                    UploadLog* log = nullptr);

  /// Calls `use` with every object whose key begins with `prefix.key`, page by page (of 1,000) as
  /// they come; its error ends the list. Errors: also kCorruptInput for a list that does not
  /// advance.
  Result<void> List(const S3Name& prefix, const std::function<Result<void>(S3Object)>& use);

  Result<S3Object> Head(const S3Name& name);
  /// The same; nothing if there is no such object.
  Result<std::optional<S3Object>> Find(const S3Name& name);

  /// Writes the object to the empty file `fd` and returns what it is. A broken transfer goes on
  /// where it broke, if it is the same version still, else from the start. The result has been
  /// checked against the size, and the MD5 where the ETag is one. Errors: also kOverBudget (larger
  /// than `max_bytes`: nothing is fetched).
  Result<S3Object> GetToFile(const S3Name& name, int fd, std::uint64_t max_bytes = UINT64_MAX);
  /// Fills `out` from byte `offset` of the object; with an `etag`, of the version that bears it.
  /// Errors: also kUnsupported (a store without ranges), kConflict (another version is there now).
  Result<void> ReadAt(const S3Name& name, std::uint64_t offset, std::span<char> out,
                      const std::string& etag = {});
  /// The same, of a small object, into memory.
  Result<std::string> Get(const S3Name& name, std::uint64_t max_bytes);

  /// Puts `size` bytes of the file `fd` from `offset`, which must not change meanwhile; returns the
  /// ETag. In one request up to 8 MiB, else in parts, of which up to kMostSenders are on their way
  /// at a time. The object appears whole or not at all, and replaces what has its key in one step.
  Result<std::string> PutFile(const S3Name& name, int fd, std::uint64_t size,
                              std::uint64_t offset = 0);
  Result<std::string> Put(const S3Name& name, std::string_view bytes);
  /// The same if there is no such object; false if there is one, possibly of a former try whose
  /// answer was lost. A store that ignores `If-None-Match: *`, or refuses to know it, replaces what
  /// is there.
  Result<bool> PutNew(const S3Name& name, std::string_view bytes);

  /// An object that does not exist is deleted already.
  Result<void> Delete(const S3Name& name);

  /// Uploads in parts under `prefix` that are neither complete nor aborted. Errors: also
  /// kUnsupported (a store that cannot list them).
  Result<S3Uploads> ListUploads(const S3Name& prefix);
  /// An upload that does not exist is aborted already.
  Result<void> AbortUpload(const S3Name& name, const std::string& id);
  /// Aborts uploads under `prefix` that began more than `age` ago by the store's clock. Returns how
  /// many; 0 with a store that cannot list them.
  Result<int> AbortStaleUploads(const S3Name& prefix, std::chrono::seconds age);

  /// The size of all parts but the last of an upload of `size` bytes: 8 MiB, doubled until 10,000
  /// parts suffice.
  static std::uint64_t PartBytes(std::uint64_t size);
  /// Of one object's parts, and threads of one client beside those that call it. Each reads its
  /// part through buffers of 256 KiB.
  static constexpr int kMostSenders = 4, kMostHelpers = 8;

 private:
  friend class S3Fetch;
  /// A request to a bucket, before it has a host.
  struct Call {
    std::string method = "GET";
    S3Name name;
    S3Query query;
    std::vector<std::string> headers;
    Payload payload;
    std::string payload_sha256;  ///< Empty: that of an empty payload.
    int patience_seconds = 0;
    bool even_if_cancelled = false;
    std::string about;  ///< What messages name; empty: `name`.
    decltype(HttpRequest::sink) sink;
    decltype(HttpRequest::begin) begin;

    std::string Shown() const { return about.empty() ? name.Shown() : about; }
  };
  /// What became of one try.
  struct Outcome {
    HttpAnswer answer;
    std::optional<Error> error;
    std::string code;    ///< The store's word for the error.
    bool retry = false;  ///< Another try may do.
    std::optional<std::chrono::seconds> retry_after;
  };

  bool cancelled() const { return cancelled_ && cancelled_(); }
  std::string RegionOf(const std::string& bucket);
  std::string UrlOf(const Call& call, const std::string& region) const;
  HttpAnswer Send(const Call& call, const std::string& region, const std::string& url);
  /// Goes once to another region or host, if that is the answer.
  HttpAnswer SendFollowing(const Call& call);
  std::string OtherRegion(const HttpAnswer& answer, const std::string& region) const;
  std::string OtherUrl(const HttpAnswer& answer, const std::string& url) const;
  Outcome Try(const Call& call);
  Outcome Judge(const Call& call, HttpAnswer answer) const;
  Error Describe(const Call& call, const HttpAnswer& answer, const S3Refusal& refusal) const;
  std::string WithoutSecrets(std::string text) const;
  /// Tries until it is done. `code`, if not null, gets the store's word for a last error.
  Result<HttpAnswer> Perform(const Call& call, std::string* code = nullptr);

  Result<std::string> PutWhole(const S3Name& name, const Payload& payload,
                               std::vector<std::string> headers = {}, std::string* code = nullptr);
  struct Parts;
  Result<std::string> PutInParts(const S3Name& name, const Payload& file);
  Result<std::string> PutParts(const S3Name& name, const std::string& id, const Payload& file);
  /// Sends parts that nobody has taken yet until there are none, or one failed.
  void SendParts(Parts& parts);
  Result<void> SendPart(Parts& parts, std::size_t index);
  /// `expected` is the tag that AWS gives such an object.
  Result<std::string> Complete(const S3Name& name, const std::string& id,
                               const std::vector<std::string>& etags, const std::string& expected,
                               std::uint64_t size);

  S3Config config_;
  std::function<bool()> cancelled_;
  UploadLog* log_;
  HttpPool pool_;
  std::mutex mutex_;
  int helpers_ = 0;                             // Guarded by mutex_.
  std::map<std::string, std::string> regions_;  // Of buckets, as learnt. Guarded by mutex_.
};

}  // namespace strata::server
