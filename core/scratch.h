// Scratch space on disk: what does not fit memory while a job runs.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "core/result.h"

namespace strata {

/// A file that only the job knows. Threads: Append one at a time; ReadAt any number at once.
class ScratchFile {
 public:
  /// `name` for messages, `size` in bytes.
  ScratchFile(int fd, std::string name, std::uint64_t size = 0)
      : fd_(fd), name_(std::move(name)), size_(size) {}
  ~ScratchFile();
  ScratchFile(const ScratchFile&) = delete;
  ScratchFile& operator=(const ScratchFile&) = delete;

  /// Writes all of `bytes` at the end. Errors: kIo (a full disk and the file size limit included),
  /// naming the folder.
  Result<void> Append(std::string_view bytes);
  /// Writes all of `bytes` at `offset`, which may lie beyond the end. Errors: kIo.
  Result<void> WriteAt(std::uint64_t offset, std::string_view bytes);
  /// Fills `out` from byte `offset`. Errors: kIo, beyond the end too.
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) const;
  /// Gives the bytes of [offset, offset + length) back to the disk where the system can.
  void Discard(std::uint64_t offset, std::uint64_t length);
  std::uint64_t size() const { return size_; }
  const std::string& name() const { return name_; }
  /// What ReadAt has read so far, bytes.
  std::uint64_t bytes_read() const { return bytes_read_.load(std::memory_order_relaxed); }
  /// The descriptor, which the caller closes. The file is not used any more.
  int Release() { return std::exchange(fd_, -1); }
  /// The open file, which stays this object's: to hand on to a child process.
  int descriptor() const { return fd_; }

 private:
  int fd_;
  std::string name_;
  std::uint64_t size_ = 0;
  mutable std::atomic<std::uint64_t> bytes_read_{0};
};

/// A file of the user's, for reading alone. Errors: kNotFound, kIo.
Result<std::unique_ptr<ScratchFile>> OpenForReading(const std::string& path);

/// A directory for scratch files. Threads: any.
class ScratchFolder {
 public:
  /// Errors: kNotFound when there is no such directory; kIo when nothing can be made in it.
  static Result<std::unique_ptr<ScratchFolder>> Open(const std::string& directory);
  /// The system's directory for temporary files: TMPDIR, or /tmp.
  static Result<std::unique_ptr<ScratchFolder>> OpenSystems();

  /// A new, empty file without a name on disk: gone with the process, however that ends.
  Result<std::unique_ptr<ScratchFile>> NewFile();
  const std::string& path() const { return path_; }

 private:
  explicit ScratchFolder(std::string path) : path_(std::move(path)) {}
  std::string path_;
};

}  // namespace strata
