#include "core/scratch.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <system_error>
#include <utility>

#include "core/signal_shield.h"

namespace strata {
namespace {

tl::unexpected<Error> SystemError(const std::string& what) {
  return Fail(ErrorCode::kIo, what + ": " + std::generic_category().message(errno));
}

}  // namespace

ScratchFile::~ScratchFile() {
  if (fd_ >= 0) close(fd_);
}

Result<void> ScratchFile::Append(std::string_view bytes) { return WriteAt(size_, bytes); }

Result<void> ScratchFile::WriteAt(std::uint64_t offset, std::string_view bytes) {
  const SignalShield shield({SIGXFSZ});
  while (!bytes.empty()) {
    const ssize_t n = pwrite(fd_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return SystemError("scratch space " + name_);
    offset += static_cast<std::uint64_t>(n);
    size_ = std::max(size_, offset);
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return {};
}

Result<void> ScratchFile::ReadAt(std::uint64_t offset, std::span<char> out) const {
  bytes_read_.fetch_add(out.size(), std::memory_order_relaxed);
  while (!out.empty()) {
    const ssize_t n = pread(fd_, out.data(), out.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return SystemError("scratch space " + name_);
    if (n == 0) {
      return Fail(ErrorCode::kIo, "scratch space " + name_ + " ends at byte " +
                                      std::to_string(offset) + "; expected " +
                                      std::to_string(out.size()) + " bytes more");
    }
    offset += static_cast<std::uint64_t>(n);
    out = out.subspan(static_cast<std::size_t>(n));
  }
  return {};
}

void ScratchFile::Discard(std::uint64_t offset, std::uint64_t length) {
  // Space only: a file system that cannot do it keeps the bytes until the file goes.
  static_cast<void>(fallocate(fd_, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE,
                              static_cast<off_t>(offset), static_cast<off_t>(length)));
}

Result<std::unique_ptr<ScratchFile>> OpenForReading(const std::string& path) {
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) {
    const bool absent = errno == ENOENT || errno == EACCES || errno == ENOTDIR;
    return Fail(absent ? ErrorCode::kNotFound : ErrorCode::kIo,
                path + ": " + std::generic_category().message(errno));
  }
  struct stat status {};
  if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode)) {
    close(fd);
    return Fail(ErrorCode::kIo, path + ": not a regular file");
  }
  return std::make_unique<ScratchFile>(fd, path, static_cast<std::uint64_t>(status.st_size));
}

Result<std::unique_ptr<ScratchFolder>> ScratchFolder::Open(const std::string& directory) {
  struct stat status {};
  if (stat(directory.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) {
    return Fail(ErrorCode::kNotFound, "scratch directory " + directory + ": no such directory");
  }
  if (access(directory.c_str(), W_OK | X_OK) != 0) {
    return SystemError("scratch directory " + directory);
  }
  return std::unique_ptr<ScratchFolder>(new ScratchFolder(directory));
}

Result<std::unique_ptr<ScratchFolder>> ScratchFolder::OpenSystems() {
  const char* variable = std::getenv("TMPDIR");
  return Open(variable != nullptr && *variable != '\0' ? variable : "/tmp");
}

Result<std::unique_ptr<ScratchFile>> ScratchFolder::NewFile() {
  int fd = open(path_.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (fd < 0) {  // A file system that has no unnamed files.
    std::string name = path_ + "/strata-scratch-XXXXXX";
    fd = mkostemp(name.data(), O_CLOEXEC);
    if (fd < 0) return SystemError("scratch directory " + path_);
    unlink(name.c_str());
  }
  return std::make_unique<ScratchFile>(fd, path_);
}

}  // namespace strata
