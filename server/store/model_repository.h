// A folder of meshes that the service reads and never writes (--models DIR).
#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/store/clock.h"
#include "server/store/file.h"

namespace strata::server {

/// A file of the repository, open for reading.
struct RepositoryFile {
  Fd fd;
  std::uint64_t size = 0;
  Timestamp modified;
  /// Device, inode, size, times of change: another fingerprint, perhaps another content.
  std::string fingerprint;
  /// False for a file changed so lately that a further change might not show in the fingerprint.
  bool settled = false;
};

/// Files below a folder, by model name. Every lookup stays below the folder whatever happens in it
/// meanwhile: the kernel resolves names with openat2 (beneath, no symbolic links); where it lacks
/// that, names are walked segment by segment without following links. Threads: any.
class ModelRepository {
 public:
  enum class Lookup { kOpenat2, kWalk };  ///< kWalk: as if the kernel lacked openat2.

  /// `path` itself may be a symbolic link. Errors: kNotFound, kIo.
  static Result<std::unique_ptr<ModelRepository>> Open(const std::string& path,
                                                       Lookup lookup = Lookup::kOpenat2);

  /// `name` has passed CheckModelName. Errors: kNotFound for what is missing, is no regular file,
  /// or lies behind a symbolic link; kIo.
  Result<RepositoryFile> OpenFile(const std::string& name) const;

  /// The first `count` names after `after`, in order of their bytes, among those that begin with
  /// `prefix`; files whose names no model may have are left out. Reads every folder whose names may
  /// match. Memory: count names. Errors: kIo.
  Result<std::vector<std::string>> List(std::string_view prefix, std::string_view after,
                                        std::size_t count) const;

 private:
  struct Listing;
  ModelRepository() = default;
  int OpenBeneath(const std::string& name, int flags) const;
  int Walk(const std::string& name, int flags) const;
  Result<void> ListFolder(const std::string& folder, Listing& listing) const;

  std::string path_;
  Lookup lookup_ = Lookup::kOpenat2;
  Fd root_;
};

}  // namespace strata::server
