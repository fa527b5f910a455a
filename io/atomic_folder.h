// Output folders that appear whole or not at all.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata::io {

/// A folder being written. Until Finish it is `.<name>.strata-<16 hex digits>.folder` beside its
/// final name, and a lock (flock) marks it as owned by a living process. Opening removes what dead
/// processes left there, as AtomicFile does.
///
/// What has the name already is replaced in Finish, in one step where the system can exchange two
/// names (Linux, most local file systems), otherwise in two, between which the name does not exist.
/// Replaced are regular files, empty folders, and folders that hold a file named as the `mark`;
/// any other folder is refused when this opens. A symbolic link is followed.
///
/// Threads: one at a time. Memory: none to speak of.
class AtomicFolder {
 public:
  /// `mark` names the file by which a folder of the same kind is known, "tileset.json".
  /// Errors: kIo; kInvalidArgument when a folder of another kind, or what is not a file or a
  /// folder, has the name.
  static Result<std::unique_ptr<AtomicFolder>> Open(const std::string& path,
                                                    const std::string& mark);
  /// Without Finish, removes all that was written.
  ~AtomicFolder();
  AtomicFolder(const AtomicFolder&) = delete;
  AtomicFolder& operator=(const AtomicFolder&) = delete;

  /// Makes the folder `name` inside. Errors: kIo.
  Result<void> AddFolder(const std::string& name);
  /// Writes a file inside ("tiles/000000.drc") and syncs it to disk. Errors: kIo with its name,
  /// byte offset and the system's reason.
  Result<void> AddFile(const std::string& name, std::string_view bytes);
  /// Syncs, gives the folder its final name, and removes what had it. Errors: kIo; then nothing
  /// has changed under the final name, but for the last sync, as in AtomicFile.
  Result<void> Finish();
  /// As Finish where nothing but an empty folder has the name; otherwise removes what was written
  /// and returns false. In one step: of several processes one succeeds.
  Result<bool> FinishIfFree();

  /// The name as the caller gave it, for messages.
  const std::string& name() const { return name_; }
  /// Bytes of all files so far.
  std::uint64_t size() const { return size_; }

 private:
  AtomicFolder() = default;
  Result<void> OpenBeside(const std::string& target, const std::string& mark);
  Result<void> CheckReplaceable(const std::string& mark);
  Result<void> CreateTemporary();
  Result<void> Sync();
  Result<void> Publish();
  void Discard();
  tl::unexpected<Error> FailIo(const std::string& what, int error) const;

  std::string name_;        // As given.
  std::string final_name_;  // Within parent_.
  std::string temporary_;   // Within parent_; empty before creation and after Finish.
  int parent_ = -1;
  int fd_ = -1;  // The folder itself; holds the lock.
  std::uint64_t size_ = 0;
  std::vector<std::string> folders_;  // Inside; to be synced.
};

}  // namespace strata::io
