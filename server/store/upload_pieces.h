// Unfinished uploads where processes share a bucket and no folder: their bytes as objects, so that
// any process can go on.
#pragma once

#include <cstdint>
#include <string>

#include "core/result.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/upload_store.h"

namespace strata::server {

/// A piece is what came since the last durable offset, an object of its own; its row and the new
/// offset are one transaction, which its holder alone can make. Threads: any.
class UploadPieces {
 public:
  UploadPieces(Database& database, BlobStore& blobs) : database_(database), blobs_(blobs) {}

  /// Puts the bytes of the file `fd` from `info.offset` to `end` as a piece. `info` then has the
  /// new offset and `expires`. Errors: kConflict (another process holds the upload), kIo,
  /// IsBucketAway, IsDatabaseAway.
  Result<void> Add(UploadInfo& info, int fd, std::uint64_t end, Timestamp expires);
  /// Writes the upload's first `end` bytes, which pieces hold, to the file `fd`. Errors: kIo,
  /// IsBucketAway, IsDatabaseAway.
  Result<void> Fetch(const std::string& upload, int fd, std::uint64_t end);
  /// In a transaction: the upload's pieces are no longer needed.
  static Result<void> Doom(Session& session, const std::string& upload);

 private:
  Result<void> Note(const UploadInfo& info, const std::string& name, std::uint64_t end,
                    Timestamp expires);

  Database& database_;
  BlobStore& blobs_;
};

}  // namespace strata::server
