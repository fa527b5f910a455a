// One upload in memory: shared by UploadStore and the append that is under way.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>

#include "io/sha256.h"
#include "server/store/upload_store.h"

namespace strata::server {

/// The columns that ReadUpload expects, for a SELECT.
extern const std::string kUploadColumns;
UploadInfo ReadUpload(const Row& row);

struct UploadAppend::Entry {
  UploadInfo info;
  DiskShare share;
  /// Of the first `hashed` bytes, as long as they came in order in this process; else the finished
  /// file is read once more.
  std::optional<io::Hasher> hasher;
  std::uint64_t hashed = 0;
  /// Where pieces lie in a bucket: the bytes from here on are also in this process's own file.
  std::uint64_t here = 0;
  bool busy = false;  ///< Somebody changes it; nobody else may.
  std::atomic<bool> stop{false};
};

}  // namespace strata::server
