// Whole objects by name, as a bucket has them: where blobs lie that are not in the data folder.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// A put in parts that was neither completed nor aborted: `name` never came to be.
struct UnfinishedPut {
  std::string name, id;
};

/// Objects below one prefix of a bucket. Names are the stores' own: letters, digits, '-', '.', '/'.
/// Threads: any; every call waits for its answer. Errors of all: IsBucketAway, and of those that
/// look at, fetch or delete an object IsObjectRefused, unless said otherwise.
class ObjectPlace {
 public:
  virtual ~ObjectPlace() = default;

  /// For messages: "s3://bucket/prefix/NAME".
  virtual std::string Shown(const std::string& name) const = 0;
  /// Puts `size` bytes of the open file `fd` from `offset`. The object appears whole or not at all.
  /// Errors: also kIo (the file), kCancelled (see Meanwhile).
  virtual Result<void> Put(const std::string& name, int fd, std::uint64_t offset,
                           std::uint64_t size) = 0;
  /// Puts `text` if there is no such object, in one step; false if there is one. A store that knows
  /// no such step puts it in any case: true then says little.
  virtual Result<bool> PutTextIfNew(const std::string& name, std::string_view text) = 0;
  struct Version {
    std::uint64_t size = 0;
    std::string tag;  ///< Another one for another content.
  };
  /// Nothing if there is no such object.
  virtual Result<std::optional<Version>> FindVersion(const std::string& name) = 0;
  /// Its size alone.
  Result<std::optional<std::uint64_t>> Find(const std::string& name);
  /// Writes the object to the empty file `fd`. Errors: also kOverBudget (larger than `max_bytes`),
  /// kIo (the file: a full disk is not the bucket's), kCancelled.
  virtual Result<void> Fetch(const std::string& name, int fd, std::uint64_t max_bytes) = 0;
  /// Fills `out` from byte `offset`; with a `tag`, of that version. Errors: also kConflict (another
  /// version is there now).
  virtual Result<void> Read(const std::string& name, std::uint64_t offset, std::span<char> out,
                            const std::string& tag) = 0;
  /// What does not exist is deleted already.
  virtual Result<void> Delete(const std::string& name) = 0;
  virtual Result<void> List(
      const std::string& prefix,
      const std::function<void(const std::string& name, std::uint64_t size)>& use) = 0;
  /// Empty where the bucket's store cannot list them.
  virtual Result<std::vector<UnfinishedPut>> Unfinished() = 0;
  virtual Result<void> Abort(const UnfinishedPut& put) = 0;

  /// Whether the last that was heard of the bucket is that it does not answer.
  virtual bool away() const = 0;
  /// Whether it answers.
  virtual Result<void> Check() = 0;
};

/// Of errors that the bucket could not be reached, or refuses whatever it is asked for. Code kIo;
/// trying again later may help.
inline constexpr ErrorKind kBucketAway;
inline bool IsBucketAway(const Error& error) { return error.kind == &kBucketAway; }
/// Such an error, which says so in front of `why`.
inline tl::unexpected<Error> FailBucketAway(const std::string& why) {
  return Fail(ErrorCode::kIo, "the bucket is away: " + why, &kBucketAway);
}
/// Whether the bucket or the database is away.
bool IsStoreAway(const Error& error);

/// Of errors that one object cannot be had, while the bucket answers for others: it is missing,
/// forbidden, or not what was put. Code kIo; trying again may help, but not for ever.
inline constexpr ErrorKind kObjectRefused;
inline bool IsObjectRefused(const Error& error) { return error.kind == &kObjectRefused; }
inline tl::unexpected<Error> FailObjectRefused(std::string why) {
  return Fail(ErrorCode::kIo, std::move(why), &kObjectRefused);
}

/// While it lives, `gone` is asked about once a second by what this thread waits for in a bucket;
/// true ends it with kCancelled. Also for what must be done meanwhile, such as heartbeats.
/// Threads: one.
class Meanwhile {
 public:
  explicit Meanwhile(std::function<bool()> gone);
  ~Meanwhile();
  Meanwhile(const Meanwhile&) = delete;
  Meanwhile& operator=(const Meanwhile&) = delete;

  /// Of this thread; false where none lives.
  static bool Gone();

 private:
  std::function<bool()> gone_;
  Meanwhile* outer_;
};

}  // namespace strata::server
