// Output files that appear whole or not at all.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "io/output_place.h"

namespace strata::io {

/// A file being written. Until Finish it is a temporary file `.<name>.strata-<16 hex digits>.part`
/// in the folder of its final name, and a lock (flock) marks it as owned by a living process.
///
/// Opening removes the temporary files that dead processes left in the same folder, whatever output
/// they were for. What is not a regular file cannot be replaced and is written straight through:
/// "-" and /dev/stdout (standard output), /dev/fd/N, character devices, FIFOs. A symbolic link is
/// followed: the file it names is replaced, the link stays. A replaced file's permissions are
/// kept; a new file gets 0666 less the umask.
///
/// On file systems without flock the temporary file is unlocked, and leftovers stay.
///
/// Memory: one buffer of 1 MiB. Threads: one at a time; different files are independent.
/// SIGPIPE and SIGXFSZ raised by its writes are swallowed and become kIo.
class AtomicFile {
 public:
  /// A folder in the file's place is replaced if it holds a file named `folder_mark` (not empty),
  /// in one step where the system can exchange names.
  /// Errors: kIo (missing folder, no permission, …); the message names the file.
  static Result<std::unique_ptr<AtomicFile>> Open(const std::string& path,
                                                  const std::string& folder_mark = {});

  /// A file `name` of the open folder `folder`, wherever that has come to stand; `shown` is its
  /// name in messages. Errors: as Open.
  static Result<std::unique_ptr<AtomicFile>> OpenIn(int folder, const std::string& name,
                                                    const std::string& shown);

  /// Without Finish, removes the temporary file.
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends. Errors: kIo with name, byte offset and the system's reason. After an error the file
  /// is spent: every later call returns that error.
  Result<void> Write(std::string_view bytes);
  /// Flushes, syncs, gives the file its final name and syncs the folder. Returns the size in bytes.
  /// Errors: kIo; then nothing has changed under the final name, with one exception: when only the
  /// folder's sync fails, the new file stands there, whole.
  Result<std::uint64_t> Finish();

  /// The name as the caller gave it, for messages.
  const std::string& name() const { return name_; }
  /// Bytes accepted so far.
  std::uint64_t size() const { return flushed_ + buffer_.size(); }

 private:
  AtomicFile() = default;
  Result<void> OpenDirect(int fd);
  Result<void> OpenReplacing(const std::string& target, const std::string& folder_mark);
  Result<void> OpenInFolder(const std::string& base, const std::string& folder_mark);
  Result<void> CreateTemporary(const std::string& base, TemporaryKind kind);
  Result<void> Flush();
  Result<void> WriteThrough(std::string_view bytes);
  Result<std::uint64_t> Publish();
  void Discard();
  tl::unexpected<Error> FailIo(const std::string& what, int error);

  std::string name_;        // As given.
  std::string final_name_;  // Within folder_; empty when written straight through.
  std::string temporary_;   // Within folder_; empty before creation and after Finish.
  int folder_ = -1;
  int fd_ = -1;
  bool can_sync_folder_ = false;
  std::uint64_t flushed_ = 0;
  std::vector<char> buffer_;
  std::string failure_;  // The first error's message.
};

/// Removes the temporary files of every AtomicFile of this process that has not finished.
///
/// For a program that is about to _exit while other threads may still be writing (the second
/// Ctrl-C). Call it from an ordinary thread: it takes a mutex. It unlinks only, so a concurrent
/// Finish either completes or fails with kIo.
void RemoveUnfinishedOutputs();

}  // namespace strata::io
