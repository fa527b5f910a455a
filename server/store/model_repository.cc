#include "server/store/model_repository.h"

#include <dirent.h>
#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>

#include "io/output_place.h"
#include "server/store/model_name.h"

namespace strata::server {
namespace {

// A link to a FIFO or a terminal must neither wait nor become ours.
constexpr int kReadFlags = O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY | O_CLOEXEC;
constexpr int kFolderFlags = O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC;
constexpr int kMaxDepth = 64;
// Coarser than any file system's clock.
constexpr std::int64_t kSettleSeconds = 3;

// What the kernel or a seccomp filter says when openat2 is not to be had.
bool LacksOpenat2(int error) { return error == ENOSYS || error == EPERM; }

std::string FingerprintOf(const struct stat& status) {
  std::string text;
  for (const auto part :
       {static_cast<std::int64_t>(status.st_dev), static_cast<std::int64_t>(status.st_ino),
        static_cast<std::int64_t>(status.st_size), static_cast<std::int64_t>(status.st_mtim.tv_sec),
        static_cast<std::int64_t>(status.st_mtim.tv_nsec),
        static_cast<std::int64_t>(status.st_ctim.tv_sec),
        static_cast<std::int64_t>(status.st_ctim.tv_nsec)}) {
    text += std::to_string(part) + ' ';
  }
  return text;
}

// The file system's times come from the machine's clock, so they are compared with that one.
bool IsSettled(const struct stat& status) {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  return status.st_ctim.tv_sec + kSettleSeconds < now.tv_sec;
}

}  // namespace

Result<std::unique_ptr<ModelRepository>> ModelRepository::Open(const std::string& path,
                                                               Lookup lookup) {
  std::unique_ptr<ModelRepository> repository(new ModelRepository);
  repository->path_ = path;
  repository->lookup_ = lookup;
  repository->root_ = Fd(open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!repository->root_) {
    return FailSystem(path, "the model repository cannot be opened", errno);
  }
  return repository;
}

int ModelRepository::OpenBeneath(const std::string& name, int flags) const {
  if (lookup_ == Lookup::kWalk) return Walk(name, flags);
  open_how how{};
  how.flags = static_cast<std::uint64_t>(flags);
  how.resolve = RESOLVE_BENEATH | RESOLVE_NO_SYMLINKS | RESOLVE_NO_MAGICLINKS;
  // EAGAIN: a rename somewhere on the way made the kernel unsure.
  for (int attempt = 0; attempt < 100; ++attempt) {
    const long fd = syscall(SYS_openat2, root_.get(), name.c_str(), &how, sizeof how);
    if (fd >= 0) return static_cast<int>(fd);
    if (LacksOpenat2(errno)) return Walk(name, flags);
    if (errno != EAGAIN && errno != EINTR) return -1;
  }
  return -1;
}

int ModelRepository::Walk(const std::string& name, int flags) const {
  Fd folder(openat(root_.get(), ".", kFolderFlags));
  for (std::size_t begin = 0; folder;) {
    const std::size_t end = name.find('/', begin);
    const std::string segment = name.substr(begin, end - begin);
    if (segment.empty() || segment == "..") {
      errno = ENOENT;
      return -1;
    }
    if (end == std::string::npos) return openat(folder.get(), segment.c_str(), flags | O_NOFOLLOW);
    folder = Fd(openat(folder.get(), segment.c_str(), kFolderFlags));
    begin = end + 1;
  }
  return -1;
}

Result<RepositoryFile> ModelRepository::OpenFile(const std::string& name) const {
  const tl::unexpected<Error> missing =
      Fail(ErrorCode::kNotFound, "model " + name + ": not in the repository");
  Fd fd(OpenBeneath(name, kReadFlags));
  if (!fd) {
    const bool link_or_none = errno == ENOENT || errno == ENOTDIR || errno == ELOOP ||
                              errno == EXDEV || errno == ENXIO || errno == ENAMETOOLONG;
    if (link_or_none) return missing;
    return FailSystem("model " + name, "cannot be opened in the repository", errno);
  }
  struct stat status;
  if (fstat(fd.get(), &status) != 0) return FailSystem(name, "cannot be looked at", errno);
  if (!S_ISREG(status.st_mode)) return missing;
  RepositoryFile file;
  file.fd = std::move(fd);
  file.size = static_cast<std::uint64_t>(status.st_size);
  file.modified =
      Timestamp(Milliseconds(status.st_mtim.tv_sec * 1000 + status.st_mtim.tv_nsec / 1'000'000));
  file.fingerprint = FingerprintOf(status);
  file.settled = IsSettled(status);
  return file;
}

// What List wants, and the smallest names found so far.
struct ModelRepository::Listing {
  std::string_view prefix, after;
  std::size_t count;
  std::set<std::string> names;
  int depth = 0;

  // Whether a folder whose names begin with `start` may hold a name that is wanted.
  bool MayHold(const std::string& start) const {
    const std::size_t shared = std::min(start.size(), prefix.size());
    if (start.compare(0, shared, prefix.substr(0, shared)) != 0) return false;
    if (start < after && !after.starts_with(start)) return false;
    return names.size() < count || start < *names.rbegin();
  }
  void Add(std::string name) {
    if (!std::string_view(name).starts_with(prefix) || name <= after) return;
    names.insert(std::move(name));
    if (names.size() > count) names.erase(std::prev(names.end()));
  }
};

Result<std::vector<std::string>> ModelRepository::List(std::string_view prefix,
                                                       std::string_view after,
                                                       std::size_t count) const {
  Listing listing{prefix, after, count, {}};
  if (count > 0) {
    if (auto listed = ListFolder("", listing); !listed) return Forward(listed);
  }
  return std::vector<std::string>(listing.names.begin(), listing.names.end());
}

Result<void> ModelRepository::ListFolder(const std::string& folder, Listing& listing) const {
  if (listing.depth >= kMaxDepth) return {};
  // A folder that went away or may not be read holds no models.
  const Fd fd(folder.empty() ? openat(root_.get(), ".", kFolderFlags)
                             : OpenBeneath(folder, kFolderFlags));
  if (!fd && folder.empty()) return FailSystem(path_, "cannot be listed", errno);
  if (!fd) return {};
  ++listing.depth;
  Result<void> result;
  auto listed = ForEachName(fd.get(), [&](const std::string& base) {
    const std::string name = folder.empty() ? base : folder + "/" + base;
    struct stat status;
    if (!result || !CheckModelName(name) ||
        fstatat(fd.get(), base.c_str(), &status, AT_SYMLINK_NOFOLLOW) != 0) {
      return;
    }
    if (S_ISREG(status.st_mode)) listing.Add(name);
    if (S_ISDIR(status.st_mode) && listing.MayHold(name + "/")) result = ListFolder(name, listing);
  });
  --listing.depth;
  return listed ? result : listed;
}

}  // namespace strata::server
