#include "server/store/data_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>

#include "io/output_place.h"

namespace strata::server {
namespace {

constexpr const char* kIdFile = "store-id";

}  // namespace

Result<std::unique_ptr<DataFolder>> DataFolder::Open(const std::string& path) {
  std::unique_ptr<DataFolder> folder(new DataFolder);
  if (auto begun = folder->Begin(path, LOCK_EX); !begun) return Forward(begun);
  if (faccessat(folder->root_.get(), kIdFile, F_OK, 0) == 0) {
    return Fail(ErrorCode::kConflict,
                path + ": belongs to a database that several processes share: give --database");
  }
  if (auto emptied = folder->Empty(folder->incoming_); !emptied) return Forward(emptied);
  return folder;
}

Result<std::unique_ptr<DataFolder>> DataFolder::OpenOwn(const std::string& path) {
  std::unique_ptr<DataFolder> folder(new DataFolder);
  if (auto begun = folder->Begin(path, LOCK_EX); !begun) return Forward(begun);
  for (const char* const mark : {"strata.db", kIdFile}) {
    if (faccessat(folder->root_.get(), mark, F_OK, 0) != 0) continue;
    return Fail(ErrorCode::kConflict,
                path + ": holds a store (" + mark +
                    "); expected a folder of this process's own: the store's content lies in a "
                    "bucket");
  }
  // Unfinished uploads go on from what lies in the bucket.
  for (const Fd* const inner : {&folder->incoming_, &folder->uploads_}) {
    if (auto emptied = folder->Empty(*inner); !emptied) return Forward(emptied);
  }
  return folder;
}

// The lock says that whoever wrote what lies there is dead.
Result<void> DataFolder::Empty(const Fd& inner) const {
  return ForEachName(inner.get(),
                     [&](const std::string& name) { io::RemoveTree(inner.get(), name.c_str()); });
}

Result<std::unique_ptr<DataFolder>> DataFolder::OpenShared(const std::string& path,
                                                           const std::string& id, bool known) {
  std::unique_ptr<DataFolder> folder(new DataFolder);
  if (auto begun = folder->Begin(path, LOCK_SH); !begun) return Forward(begun);
  if (auto claimed = folder->Claim(id, known); !claimed) return Forward(claimed);
  return folder;
}

Result<void> DataFolder::Begin(const std::string& path, int lock_operation) {
  path_ = path;
  auto root = OpenFolder(AT_FDCWD, path);
  if (!root) return Forward(root);
  root_ = std::move(*root);
  if (auto locked = Lock(lock_operation); !locked) return locked;
  return OpenInner();
}

// Two stores in one folder would take each other's files for leftovers.
Result<void> DataFolder::Claim(const std::string& id, bool known) {
  if (faccessat(root_.get(), "strata.db", F_OK, 0) == 0) {
    return Fail(ErrorCode::kConflict,
                path_ + ": holds a store of SQLite's (strata.db), expected a folder of its own");
  }
  Fd file(openat(root_.get(), kIdFile, O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  if (!file && errno != ENOENT) return FailSystem(path_ + "/" + kIdFile, "cannot be read", errno);
  if (!file && known) {
    return Fail(ErrorCode::kConflict, path_ + ": has no file " + kIdFile +
                                          ", so it is not the folder that this database's other "
                                          "processes share; expected the id " +
                                          id + " in it");
  }
  if (!file) {
    // Under a name of its own, then linked: nobody reads half an id.
    const std::string draft = std::string(kIdFile) + "." + RandomId();
    const Fd made(
        openat(root_.get(), draft.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
    std::uint64_t written = 0;
    if (!made || io::WriteAll(made.get(), id, written) != 0 || fsync(made.get()) != 0) {
      return FailSystem(path_ + "/" + draft, "cannot be written", errno);
    }
    const int linked = linkat(root_.get(), draft.c_str(), root_.get(), kIdFile, 0);
    const int error = errno;
    unlinkat(root_.get(), draft.c_str(), 0);
    if (linked != 0 && error != EEXIST) return FailSystem(path_, "cannot be marked", error);
    if (auto synced = SyncFolder(root_, path_); !synced) return synced;
    file = Fd(openat(root_.get(), kIdFile, O_RDONLY | O_NOFOLLOW | O_CLOEXEC));
  }
  std::array<char, 64> text{};
  const ssize_t size = file ? pread(file.get(), text.data(), text.size(), 0) : -1;
  const std::string found(text.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
  if (found == id) return {};
  return Fail(ErrorCode::kConflict, path_ + "/" + kIdFile + ": the id " + found +
                                        " found, expected " + id +
                                        ": the folder belongs to another "
                                        "database");
}

Result<void> DataFolder::Lock(int operation) {
  lock_ = Fd(openat(root_.get(), "lock", O_RDWR | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0600));
  if (!lock_) return FailSystem(path_ + "/lock", "cannot be opened", errno);
  if (flock(lock_.get(), operation | LOCK_NB) != 0) {
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
  return {};
}

}  // namespace strata::server
