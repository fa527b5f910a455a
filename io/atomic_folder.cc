#include "io/atomic_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "io/output_place.h"

namespace strata::io {

tl::unexpected<Error> AtomicFolder::FailIo(const std::string& what, int error) const {
  return Fail(ErrorCode::kIo, name_ + ": " + what + ": " + SystemReason(error));
}

Result<std::unique_ptr<AtomicFolder>> AtomicFolder::Open(const std::string& path,
                                                         const std::string& mark) {
  std::unique_ptr<AtomicFolder> folder(new AtomicFolder);
  folder->name_ = path;
  if (auto opened = folder->OpenBeside(ResolveLinks(path), mark); !opened) return Forward(opened);
  return folder;
}

Result<void> AtomicFolder::OpenBeside(const std::string& target, const std::string& mark) {
  if (target.empty()) return FailIo("cannot open for writing", name_.empty() ? ENOENT : ELOOP);
  const std::string parent = FolderOf(target);
  final_name_ = target.substr(target.rfind('/') + 1);
  if (final_name_.empty() || final_name_ == "." || final_name_ == "..") {
    return FailIo("cannot write", EISDIR);
  }
  parent_ = open(parent.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent_ < 0) return FailIo("cannot open its folder '" + parent + "'", errno);
  if (auto checked = CheckReplaceable(mark); !checked) return checked;
  RemoveLeftovers(parent_);
  return CreateTemporary();
}

Result<void> AtomicFolder::CheckReplaceable(const std::string& mark) {
  const std::string why_not = WhyNotReplaceable(parent_, final_name_, mark);
  if (why_not.empty()) return {};
  return Fail(ErrorCode::kInvalidArgument, name_ + ": " + why_not);
}

Result<void> AtomicFolder::CreateTemporary() {
  for (int attempt = 0; attempt < 100; ++attempt) {
    const std::string name = NewTemporaryName(final_name_, TemporaryKind::kFolder);
    if (mkdirat(parent_, name.c_str(), 0777) != 0) {
      if (errno == EEXIST) continue;
      return FailIo("cannot create a temporary folder beside it", errno);
    }
    RegisterTemporary(parent_, name);
    fd_ = openat(parent_, name.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
    const bool taken = fd_ < 0 || (flock(fd_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK);
    if (!taken && NameRefersTo(parent_, name.c_str(), fd_)) {
      temporary_ = name;
      return {};
    }
    // Another process took the folder for a leftover before it was locked; it removes it.
    UnregisterTemporary(parent_, name);
    if (fd_ >= 0) close(std::exchange(fd_, -1));
  }
  return FailIo("cannot create a temporary folder beside it", EBUSY);
}

Result<void> AtomicFolder::AddFolder(const std::string& name) {
  if (mkdirat(fd_, name.c_str(), 0777) != 0) {
    return FailIo("cannot create '" + name + "' in it", errno);
  }
  folders_.push_back(name);
  return {};
}

Result<void> AtomicFolder::AddFile(const std::string& name, std::string_view bytes) {
  const int flags = O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC;
  const int file = openat(fd_, name.c_str(), flags, 0666);
  if (file < 0) return FailIo("cannot create '" + name + "' in it", errno);
  std::uint64_t written = 0;
  int error = WriteAll(file, bytes, written);
  if (error == 0 && fsync(file) != 0) error = errno;
  if (close(file) != 0 && error == 0) error = errno;
  size_ += written;
  if (error == 0) return {};
  return FailIo(name + ": byte " + std::to_string(written) + ": cannot write " +
                    std::to_string(bytes.size() - written) + " bytes",
                error);
}

Result<void> AtomicFolder::Sync() {
  int error = SyncFolder(fd_, ".");
  for (const std::string& inner : folders_) {
    if (error == 0) error = SyncFolder(fd_, inner.c_str());
  }
  return error == 0 ? Result<void>() : FailIo("cannot sync to disk", error);
}

Result<void> AtomicFolder::Finish() {
  if (temporary_.empty()) return Fail(ErrorCode::kInternal, name_ + ": finished twice");
  Result<void> done = Sync();
  if (done) done = Publish();
  Discard();
  return done;
}

Result<bool> AtomicFolder::FinishIfFree() {
  if (temporary_.empty()) return Fail(ErrorCode::kInternal, name_ + ": finished twice");
  auto synced = Sync();
  const bool free =
      synced && renameat(parent_, temporary_.c_str(), parent_, final_name_.c_str()) == 0;
  const int error = free ? 0 : errno;
  if (free) {
    UnregisterTemporary(parent_, std::exchange(temporary_, {}));
    if (fsync(parent_) != 0 && errno != EINVAL) synced = FailIo("cannot sync its folder", errno);
  }
  Discard();
  if (!synced) return Forward(synced);
  if (free || error == ENOTEMPTY || error == EEXIST || error == ENOTDIR) return free;
  return FailIo("cannot give the finished folder its name", error);
}

Result<void> AtomicFolder::Publish() {
  const Replacement named = GiveFinalName(parent_, temporary_, final_name_);
  if (named.error != 0) return FailIo("cannot give the finished folder its name", named.error);
  UnregisterTemporary(parent_, std::exchange(temporary_, {}));
  if (fsync(parent_) != 0 && errno != EINVAL) {
    return FailIo("cannot sync its folder to disk", errno);
  }
  if (!named.replaced.empty()) RemoveTree(parent_, named.replaced.c_str());
  return {};
}

// Removes before closing: while the lock is held nobody else can take the name for a leftover.
void AtomicFolder::Discard() {
  if (!temporary_.empty()) {
    RemoveTree(parent_, temporary_.c_str());
    UnregisterTemporary(parent_, temporary_);
    temporary_.clear();
  }
  if (fd_ >= 0) close(std::exchange(fd_, -1));
  if (parent_ >= 0) close(std::exchange(parent_, -1));
}

AtomicFolder::~AtomicFolder() { Discard(); }

}  // namespace strata::io
