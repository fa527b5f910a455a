#include "server/store/data_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>

#include "io/output_place.h"

namespace strata::server {

Result<std::unique_ptr<DataFolder>> DataFolder::Open(const std::string& path) {
  std::unique_ptr<DataFolder> folder(new DataFolder);
  folder->path_ = path;
  auto root = OpenFolder(AT_FDCWD, path);
  if (!root) return Forward(root);
  folder->root_ = std::move(*root);
  if (auto locked = folder->Lock(); !locked) return Forward(locked);
  if (auto opened = folder->OpenInner(); !opened) return Forward(opened);
  return folder;
}

Result<void> DataFolder::Lock() {
  lock_ = Fd(openat(root_.get(), "lock", O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0600));
  if (!lock_) return FailSystem(path_ + "/lock", "cannot be opened", errno);
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) return FailSystem(path_ + "/lock", "cannot be locked", errno);
    std::array<char, 32> owner{};
    const ssize_t size = pread(lock_.get(), owner.data(), owner.size(), 0);
    const std::string id(owner.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
    return Fail(ErrorCode::kConflict, path_ + ": the data folder belongs to another process" +
                                          (id.empty() ? "" : ", number " + id));
  }
  // For the message above alone; the lock is what counts, so a full disk does no harm here.
  const std::string id = std::to_string(getpid());
  if (ftruncate(lock_.get(), 0) != 0 || pwrite(lock_.get(), id.data(), id.size(), 0) < 0) {
    return {};
  }
  return {};
}

Result<void> DataFolder::OpenInner() {
  for (const auto& [name, folder] :
       {std::pair{"blobs", &blobs_}, {"incoming", &incoming_}, {"uploads", &uploads_}}) {
    auto opened = OpenFolder(root_.get(), name);
    if (!opened) return Forward(opened);
    *folder = std::move(*opened);
  }
  // The lock says that whoever wrote these is dead.
  return ForEachName(incoming_.get(), [this](const std::string& name) {
    io::RemoveTree(incoming_.get(), name.c_str());
  });
}

}  // namespace strata::server
