// The bytes of a blob that lies in a bucket alone.
#pragma once

#include <cstdint>
#include <functional>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "io/sha256.h"
#include "server/store/object_place.h"

namespace strata::server {

/// Reads an object by ranges of 1 MiB or what is asked for, whichever is more. Of a reading from
/// the first byte to the last the SHA-256 is checked, and what is wrong is refused before its last
/// bytes are given. Memory: one such range. Threads: any, one at a time inside.
class ObjectReader {
 public:
  struct Object {
    std::string name;  ///< In `place`.
    std::string hash;  ///< SHA-256; empty: not known, and not checked.
    std::uint64_t size = 0;
    std::string tag;  ///< Of an object that may be replaced: the version that is read.
  };
  /// `keep` is called before each range: it may see to it that the object stays. `place` outlives
  /// the reader.
  ObjectReader(ObjectPlace& place, Object object, std::function<void()> keep)
      : place_(place), object_(std::move(object)), keep_(std::move(keep)) {}

  /// Fills `out` from byte `offset`. Errors: kIo (IsBucketAway; the end included; another content
  /// or version).
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out);

 private:
  Result<void> Load(std::uint64_t offset, std::size_t wanted);

  ObjectPlace& place_;
  const Object object_;
  const std::function<void()> keep_;
  std::mutex mutex_;  // Guards all below.
  std::vector<char> range_;
  std::uint64_t begin_ = 0;  // Of range_.
  io::Hasher hasher_;
  std::uint64_t hashed_ = 0;
};

}  // namespace strata::server
