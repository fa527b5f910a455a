#include "io/atomic_file.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "io/output_place.h"

namespace strata::io {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 20;

}  // namespace

tl::unexpected<Error> AtomicFile::FailIo(const std::string& what, int error) {
  failure_ = name_ + ": " + what + ": " + SystemReason(error);
  return Fail(ErrorCode::kIo, failure_);
}

Result<std::unique_ptr<AtomicFile>> AtomicFile::Open(const std::string& path,
                                                     const std::string& folder_mark) {
  std::unique_ptr<AtomicFile> file(new AtomicFile);
  file->buffer_.reserve(kBufferBytes);
  file->name_ = path == "-" ? "standard output" : path;
  if (path.empty()) return Fail(ErrorCode::kIo, "the output has an empty name");
  Result<void> opened;
  if (const auto own = OwnDescriptor(path)) {
    opened = file->OpenDirect(fcntl(*own, F_DUPFD_CLOEXEC, 3));
  } else if (IsWrittenThrough(path)) {
    opened = file->OpenDirect(open(path.c_str(), O_WRONLY | O_CLOEXEC | O_NOCTTY));
  } else {
    opened = file->OpenReplacing(ResolveLinks(path), folder_mark);
  }
  if (!opened) return Forward(opened);
  return file;
}

Result<std::unique_ptr<AtomicFile>> AtomicFile::OpenIn(int folder, const std::string& name,
                                                       const std::string& shown) {
  std::unique_ptr<AtomicFile> file(new AtomicFile);
  file->buffer_.reserve(kBufferBytes);
  file->name_ = shown;
  file->folder_ = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (file->folder_ < 0) return file->FailIo("cannot open its folder", errno);
  file->can_sync_folder_ = true;
  if (auto opened = file->OpenInFolder(name, {}); !opened) return Forward(opened);
  return file;
}

Result<void> AtomicFile::OpenDirect(int fd) {
  if (fd < 0) return FailIo("cannot open for writing", errno);
  fd_ = fd;
  return {};
}

Result<void> AtomicFile::OpenReplacing(const std::string& target, const std::string& folder_mark) {
  if (target.empty()) return FailIo("cannot open for writing", ELOOP);
  const std::string folder = FolderOf(target);
  const std::string base = target.substr(target.rfind('/') + 1);
  if (base.empty() || base == "." || base == "..") return FailIo("cannot write", EISDIR);
  folder_ = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  can_sync_folder_ = folder_ >= 0;
  // A folder that may be written but not listed is still good for output.
  if (folder_ < 0 && errno == EACCES) {
    folder_ = open(folder.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC);
  }
  if (folder_ < 0) return FailIo("cannot open its folder '" + folder + "'", errno);
  return OpenInFolder(base, folder_mark);
}

Result<void> AtomicFile::OpenInFolder(const std::string& base, const std::string& folder_mark) {
  struct stat status;
  const bool exists = fstatat(folder_, base.c_str(), &status, 0) == 0;
  const bool is_folder = exists && S_ISDIR(status.st_mode);
  if (is_folder && (folder_mark.empty() || !IsMarkedFolder(folder_, base, folder_mark))) {
    return FailIo("cannot write", EISDIR);
  }
  if (can_sync_folder_) RemoveLeftovers(folder_);
  auto created = CreateTemporary(base, is_folder ? TemporaryKind::kFolder : TemporaryKind::kFile);
  if (!created) return created;
  if (exists && !is_folder && fchmod(fd_, status.st_mode & 0777) != 0) {
    return FailIo("cannot set the permissions of the new file", errno);
  }
  final_name_ = base;
  return {};
}

Result<void> AtomicFile::CreateTemporary(const std::string& base, TemporaryKind kind) {
  for (int attempt = 0; attempt < 100; ++attempt) {
    const std::string name = NewTemporaryName(base, kind);
    const int flags = O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC;
    fd_ = openat(folder_, name.c_str(), flags, 0666);
    if (fd_ < 0 && errno == EEXIST) continue;
    if (fd_ < 0) return FailIo("cannot create a temporary file beside it", errno);
    RegisterTemporary(folder_, name);
    const bool taken = flock(fd_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    if (!taken && NameRefersTo(folder_, name.c_str(), fd_)) {
      temporary_ = name;
      return {};
    }
    // Another process took the file for a leftover before it was locked; it removes it.
    UnregisterTemporary(folder_, name);
    close(std::exchange(fd_, -1));
  }
  return FailIo("cannot create a temporary file beside it", EBUSY);
}

Result<void> AtomicFile::WriteThrough(std::string_view bytes) {
  const std::uint64_t before = flushed_;
  const int error = WriteAll(fd_, bytes, flushed_);
  if (error == 0) return {};
  const std::uint64_t missing = bytes.size() - (flushed_ - before);
  return FailIo(
      "byte " + std::to_string(flushed_) + ": cannot write " + std::to_string(missing) + " bytes",
      error);
}

Result<void> AtomicFile::Flush() {
  auto written = WriteThrough({buffer_.data(), buffer_.size()});
  buffer_.clear();
  return written;
}

Result<void> AtomicFile::Write(std::string_view bytes) {
  if (!failure_.empty()) return Fail(ErrorCode::kIo, failure_);
  if (fd_ < 0) return Fail(ErrorCode::kInternal, name_ + ": written after it was finished");
  if (buffer_.size() + bytes.size() > kBufferBytes) {
    if (auto flushed = Flush(); !flushed) return flushed;
    if (bytes.size() >= kBufferBytes) return WriteThrough(bytes);
  }
  buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
  return {};
}

Result<std::uint64_t> AtomicFile::Finish() {
  if (!failure_.empty()) return Fail(ErrorCode::kIo, failure_);
  if (fd_ < 0) return Fail(ErrorCode::kInternal, name_ + ": finished twice");
  auto flushed = Flush();
  if (!flushed) {
    Discard();
    return Forward(flushed);
  }
  if (!final_name_.empty()) return Publish();
  if (close(std::exchange(fd_, -1)) != 0) return FailIo("cannot close", errno);
  return flushed_;
}

Result<std::uint64_t> AtomicFile::Publish() {
  Result<std::uint64_t> result = flushed_;
  if (fsync(fd_) != 0) {
    result = FailIo("cannot sync to disk", errno);
  } else {
    const Replacement named = GiveFinalName(folder_, temporary_, final_name_);
    if (named.error != 0) {
      result = FailIo("cannot give the finished file its name", named.error);
    } else {
      UnregisterTemporary(folder_, std::exchange(temporary_, {}));
      if (can_sync_folder_ && fsync(folder_) != 0 && errno != EINVAL) {
        result = FailIo("cannot sync its folder to disk", errno);
      }
      if (!named.replaced.empty()) RemoveTree(folder_, named.replaced.c_str());
    }
  }
  Discard();
  return result;
}

// Unlinks before closing: while the lock is held nobody else can take the name for a leftover.
void AtomicFile::Discard() {
  if (!temporary_.empty()) {
    unlinkat(folder_, temporary_.c_str(), 0);
    UnregisterTemporary(folder_, temporary_);
    temporary_.clear();
  }
  if (fd_ >= 0) close(std::exchange(fd_, -1));
  if (folder_ >= 0) close(std::exchange(folder_, -1));
}

AtomicFile::~AtomicFile() { Discard(); }

}  // namespace strata::io
