#include "io/job_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "io/output_place.h"

namespace strata::io {
namespace {

constexpr std::string_view kPrefix = "strata-job-";
constexpr std::size_t kKeyDigits = 32;
constexpr const char* kRuns = "runs";
constexpr const char* kCheckpoint = "checkpoint";
constexpr const char* kNewCheckpoint = "checkpoint.new";
constexpr std::uint64_t kMostCheckpointBytes = 64 << 20;

std::optional<TemporaryKind> KindOfJob(std::string_view name) {
  if (name.size() != kPrefix.size() + kKeyDigits || !name.starts_with(kPrefix)) return {};
  name.remove_prefix(kPrefix.size());
  if (name.find_first_not_of("0123456789abcdef") != std::string_view::npos) return {};
  return TemporaryKind::kFolder;
}

int OpenFolder(int parent, const char* name) {
  return openat(parent, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
}

// Somebody else could have put anything into a folder of theirs.
bool IsOwn(int fd) {
  struct stat status;
  return fstat(fd, &status) == 0 && status.st_uid == geteuid() && (status.st_mode & 077) == 0;
}

}  // namespace

Result<std::unique_ptr<JobFolder>> JobFolder::Open(const std::string& directory,
                                                   const std::string& key, bool go_on) {
  const int parent = open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent < 0) {
    return Fail(ErrorCode::kIo, "scratch directory " + directory + ": " + SystemReason(errno));
  }
  std::unique_ptr<JobFolder> job(new JobFolder(directory, key, parent, go_on));
  if (go_on) static_cast<void>(job->TakeOver());
  return job;
}

JobFolder::JobFolder(std::string directory, const std::string& key, int parent, bool keep)
    : directory_(std::move(directory)),
      name_(std::string(kPrefix) + key),
      parent_(parent),
      keep_(keep) {}

JobFolder::~JobFolder() {
  if (fd_ >= 0) {
    if (!keep_) RemoveTree(parent_, name_.c_str());
    UnregisterTemporary(parent_, name_);
    close(fd_);
  }
  close(parent_);
}

bool JobFolder::TakeOver() {
  const int fd = OpenFolder(parent_, name_.c_str());
  if (fd < 0) return false;
  if (IsOwn(fd) && flock(fd, LOCK_EX | LOCK_NB) == 0 && NameRefersTo(parent_, name_.c_str(), fd)) {
    if (!keep_) RegisterTemporary(parent_, name_);
    fd_ = fd;
    return true;
  }
  close(fd);
  return false;
}

void JobFolder::Create() {
  // Another process that cleans up may take it for a leftover before it is locked.
  for (int attempt = 0; fd_ < 0 && attempt < 100; ++attempt) {
    if (mkdirat(parent_, name_.c_str(), 0700) != 0) return;
    static_cast<void>(TakeOver());
  }
}

Result<std::unique_ptr<ScratchFile>> JobFolder::OpenRuns(std::uint64_t keep) {
  if (fd_ < 0) Create();
  if (fd_ < 0) {
    auto folder = ScratchFolder::Open(directory_);
    if (!folder) return Forward(folder);
    return (*folder)->NewFile();
  }
  if (keep == 0) {
    unlinkat(fd_, kCheckpoint, 0);
    unlinkat(fd_, kRuns, 0);
  }
  const int create = keep == 0 ? O_CREAT | O_EXCL : 0;
  const int file = openat(fd_, kRuns, O_RDWR | O_NOFOLLOW | O_CLOEXEC | create, 0600);
  if (file < 0) return FailIo("cannot open its runs");
  struct stat status;
  if (fstat(file, &status) != 0 || static_cast<std::uint64_t>(status.st_size) < keep) {
    close(file);
    return Fail(ErrorCode::kIo, "scratch space " + directory_ + "/" + name_ + ": found " +
                                    std::to_string(status.st_size) +
                                    " bytes of runs; expected at least " + std::to_string(keep) +
                                    "; start without --resume");
  }
  if (ftruncate(file, static_cast<off_t>(keep)) != 0) {
    const int error = errno;
    close(file);
    errno = error;
    return FailIo("cannot cut its runs");
  }
  return std::make_unique<ScratchFile>(file, directory_, keep);
}

Result<std::optional<std::string>> JobFolder::Load() {
  if (fd_ < 0) return std::optional<std::string>();
  const int file = openat(fd_, kCheckpoint, O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  if (file < 0 && errno == ENOENT) return std::optional<std::string>();
  if (file < 0) return FailIo("cannot open its checkpoint");
  struct stat status;
  const bool known = fstat(file, &status) == 0 && S_ISREG(status.st_mode);
  const auto size = static_cast<std::uint64_t>(known ? status.st_size : 0);
  const ScratchFile checkpoint(file, directory_ + "/" + name_, size);
  if (size > kMostCheckpointBytes) return FailIo("its checkpoint is too large");
  std::string bytes(size, 0);
  if (auto read = checkpoint.ReadAt(0, bytes); !read) return Forward(read);
  return std::optional<std::string>(std::move(bytes));
}

Result<void> JobFolder::Save(std::string_view bytes) {
  if (fd_ < 0) return {};
  const int flags = O_WRONLY | O_CREAT | O_TRUNC | O_NOFOLLOW | O_CLOEXEC;
  const int file = openat(fd_, kNewCheckpoint, flags, 0600);
  if (file < 0) return FailIo("cannot write a checkpoint");
  std::uint64_t written = 0;
  int error = WriteAll(file, bytes, written);
  if (close(file) != 0 && error == 0) error = errno;
  if (error == 0 && renameat(fd_, kNewCheckpoint, fd_, kCheckpoint) != 0) error = errno;
  errno = error;
  return error == 0 ? Result<void>() : FailIo("cannot write a checkpoint");
}

tl::unexpected<Error> JobFolder::FailIo(const std::string& what) const {
  const std::string reason = SystemReason(errno);
  return Fail(ErrorCode::kIo,
              "scratch space " + directory_ + "/" + name_ + ": " + what + ": " + reason);
}

std::vector<std::string> JobKeysIn(const std::string& directory) {
  std::vector<std::string> keys;
  const int parent = open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent < 0) return keys;
  for (const std::string& name : NamesIn(parent)) {
    if (KindOfJob(name)) keys.push_back(name.substr(kPrefix.size()));
  }
  close(parent);
  return keys;
}

void RemoveAbandonedJobs(const std::string& directory) {
  const int parent = open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent < 0) return;
  RemoveLeftovers(parent, KindOfJob);
  close(parent);
}

}  // namespace strata::io
