#include "io/output_place.h"

#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <climits>
#include <ctime>
#include <mutex>
#include <set>
#include <system_error>
#include <utility>
#include <vector>

#include "core/signal_shield.h"
#include "io/atomic_file.h"

namespace strata::io {
namespace {

constexpr std::string_view kInfix = ".strata-";
constexpr std::string_view kFileSuffix = ".part";
constexpr std::string_view kFolderSuffix = ".folder";
constexpr std::size_t kRandomDigits = 16;

std::string_view SuffixOf(TemporaryKind kind) {
  return kind == TemporaryKind::kFile ? kFileSuffix : kFolderSuffix;
}

std::size_t DecorationOf(TemporaryKind kind) {
  return 1 + kInfix.size() + kRandomDigits + SuffixOf(kind).size();
}

// (folder descriptor, name) of every temporary output of this process.
struct Registry {
  std::mutex mutex;
  std::set<std::pair<int, std::string>> entries;
};
Registry& TheRegistry() {
  // Never destroyed: a watcher thread may call while static destructors run.
  static Registry& registry = *new Registry;
  return registry;
}

// A lock that can be taken says that the owner is dead, or has created the file and not locked it
// yet; such an owner finds its name gone once it has the lock, and starts again.
void RemoveIfAbandoned(int folder, const char* name, TemporaryKind kind) {
  const int fd = openat(folder, name, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return;
  struct stat status;
  const bool known = fstat(fd, &status) == 0;
  const bool right_type = known && (S_ISREG(status.st_mode) ||
                                    (kind == TemporaryKind::kFolder && S_ISDIR(status.st_mode)));
  if (right_type && flock(fd, LOCK_EX | LOCK_NB) == 0 && NameRefersTo(folder, name, fd)) {
    RemoveTree(folder, name);
  }
  close(fd);
}

std::string RandomDigits() {
  std::uint64_t bits = 0;
  if (getrandom(&bits, sizeof bits, GRND_NONBLOCK) != static_cast<ssize_t>(sizeof bits)) {
    timespec now{};
    clock_gettime(CLOCK_REALTIME, &now);
    bits = static_cast<std::uint64_t>(now.tv_nsec) << 32 ^ static_cast<std::uint64_t>(getpid());
  }
  std::string digits(kRandomDigits, '0');
  for (char& c : digits) {
    c = "0123456789abcdef"[bits & 15];
    bits >>= 4;
  }
  return digits;
}

}  // namespace

std::vector<std::string> NamesIn(int folder) {
  std::vector<std::string> names;
  const int fd = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  DIR* entries = fd < 0 ? nullptr : fdopendir(fd);
  if (entries == nullptr) {
    if (fd >= 0) close(fd);
    return names;
  }
  while (const dirent* entry = readdir(entries)) {
    const std::string_view name = entry->d_name;
    if (name != "." && name != "..") names.emplace_back(name);
  }
  closedir(entries);
  return names;
}

std::string NewTemporaryName(const std::string& base, TemporaryKind kind) {
  const std::string stem = "." + base.substr(0, NAME_MAX - DecorationOf(kind));
  return stem + std::string(kInfix) + RandomDigits() + std::string(SuffixOf(kind));
}

void RegisterTemporary(int parent, const std::string& name) {
  Registry& registry = TheRegistry();
  const std::lock_guard lock(registry.mutex);
  registry.entries.emplace(parent, name);
}

void UnregisterTemporary(int parent, const std::string& name) {
  Registry& registry = TheRegistry();
  const std::lock_guard lock(registry.mutex);
  registry.entries.erase({parent, name});
}

void RemoveUnfinishedOutputs() {
  Registry& registry = TheRegistry();
  const std::lock_guard lock(registry.mutex);
  for (const auto& [parent, name] : registry.entries) RemoveTree(parent, name.c_str());
  registry.entries.clear();
}

bool NameRefersTo(int parent, const char* name, int fd) {
  struct stat by_name, by_fd;
  return fstatat(parent, name, &by_name, AT_SYMLINK_NOFOLLOW) == 0 && fstat(fd, &by_fd) == 0 &&
         by_name.st_dev == by_fd.st_dev && by_name.st_ino == by_fd.st_ino;
}

std::optional<TemporaryKind> KindOfTemporary(std::string_view name) {
  for (const TemporaryKind kind : {TemporaryKind::kFile, TemporaryKind::kFolder}) {
    if (name.size() <= DecorationOf(kind) || name.front() != '.') continue;
    if (!name.ends_with(SuffixOf(kind))) continue;
    std::string_view stem = name.substr(0, name.size() - SuffixOf(kind).size());
    const std::string_view digits = stem.substr(stem.size() - kRandomDigits);
    if (digits.find_first_not_of("0123456789abcdef") != std::string_view::npos) continue;
    stem.remove_suffix(kRandomDigits);
    if (stem.ends_with(kInfix)) return kind;
  }
  return std::nullopt;
}

void RemoveLeftovers(int folder, KindOfName kind) {
  for (const std::string& name : NamesIn(folder)) {
    if (const auto ours = kind(name)) RemoveIfAbandoned(folder, name.c_str(), *ours);
  }
}

Replacement GiveFinalName(int parent, const std::string& temporary, const std::string& final_name) {
  return GiveFinalName(parent, temporary, parent, final_name);
}

Replacement GiveFinalName(int from, const std::string& temporary, int parent,
                          const std::string& final_name) {
  const char *old = temporary.c_str(), *to = final_name.c_str();
  if (renameat(from, old, parent, to) == 0) return {};
  if (errno != EISDIR && errno != ENOTDIR && errno != ENOTEMPTY && errno != EEXIST)
    return {errno, {}};
  if (renameat2(from, old, parent, to, RENAME_EXCHANGE) == 0) return {0, temporary};
  if (errno != EINVAL && errno != ENOSYS) return {errno, {}};
  const std::string replaced = NewTemporaryName(final_name, TemporaryKind::kFolder);
  if (renameat(parent, to, parent, replaced.c_str()) != 0) return {errno, {}};
  if (renameat(from, old, parent, to) == 0) return {0, replaced};
  const int error = errno;
  renameat(parent, replaced.c_str(), parent, to);
  return {error, {}};
}

bool IsMarkedFolder(int parent, const std::string& name, const std::string& mark) {
  struct stat status;
  return fstatat(parent, (name + "/" + mark).c_str(), &status, AT_SYMLINK_NOFOLLOW) == 0 &&
         S_ISREG(status.st_mode);
}

bool IsEmptyFolder(int parent, const char* name) {
  const int fd = openat(parent, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (fd < 0) return false;
  const bool empty = NamesIn(fd).empty();
  close(fd);
  return empty;
}

std::string WhyNotReplaceable(int parent, const std::string& name, const std::string& mark) {
  struct stat status;
  if (fstatat(parent, name.c_str(), &status, AT_SYMLINK_NOFOLLOW) != 0) return {};
  if (S_ISREG(status.st_mode)) return {};
  if (!S_ISDIR(status.st_mode)) {
    return "found a device or pipe, expected a name for a folder";
  }
  if (IsMarkedFolder(parent, name, mark) || IsEmptyFolder(parent, name.c_str())) return {};
  return "found a folder without '" + mark +
         "', expected a free name, a file, or a folder of tiles to replace";
}

int SyncFolder(int parent, const char* name) {
  const int folder = openat(parent, name, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const int error = folder < 0 || (fsync(folder) != 0 && errno != EINVAL) ? errno : 0;
  if (folder >= 0) close(folder);
  return error;
}

void RemoveTree(int parent, const char* name) {
  if (unlinkat(parent, name, 0) == 0 || (errno != EISDIR && errno != EPERM)) return;
  const int fd = openat(parent, name, O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (fd < 0) return;
  // Another process may still put something in.
  for (int attempt = 0; attempt < 100; ++attempt) {
    for (const std::string& inner : NamesIn(fd)) RemoveTree(fd, inner.c_str());
    if (unlinkat(parent, name, AT_REMOVEDIR) == 0 || (errno != ENOTEMPTY && errno != EEXIST)) break;
  }
  close(fd);
}

std::string SystemReason(int error) { return std::generic_category().message(error); }

std::string FolderOf(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

std::string ResolveLinks(std::string path) {
  for (int hops = 0; hops < 40; ++hops) {
    std::array<char, PATH_MAX> target;
    const ssize_t length = readlink(path.c_str(), target.data(), target.size());
    if (length < 0) return path;
    const std::string link(target.data(), static_cast<std::size_t>(length));
    path = link.starts_with('/') ? link : FolderOf(path) + "/" + link;
  }
  return {};
}

std::optional<int> OwnDescriptor(std::string_view path) {
  if (path == "-" || path == "/dev/stdout") return STDOUT_FILENO;
  if (path == "/dev/stderr") return STDERR_FILENO;
  for (const std::string_view prefix : {"/dev/fd/", "/proc/self/fd/"}) {
    if (!path.starts_with(prefix)) continue;
    int fd = -1;
    const char* end = path.data() + path.size();
    const auto [stop, error] = std::from_chars(path.data() + prefix.size(), end, fd);
    if (error == std::errc() && stop == end && fd >= 0) return fd;
  }
  return std::nullopt;
}

bool IsWrittenThrough(const std::string& path) {
  struct stat status;
  return OwnDescriptor(path) ||
         (stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode));
}

int WriteAll(int fd, std::string_view bytes, std::uint64_t& written) {
  const SignalShield shield({SIGPIPE, SIGXFSZ});
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n > 0) {
      written += static_cast<std::uint64_t>(n);
      bytes.remove_prefix(static_cast<std::size_t>(n));
    } else if (n < 0 && errno == EAGAIN) {
      pollfd ready{fd, POLLOUT, 0};
      poll(&ready, 1, -1);
    } else if (n == 0 || errno != EINTR) {
      return n == 0 ? EIO : errno;
    }
  }
  return 0;
}

}  // namespace strata::io
