#include "server/store/file.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <vector>

#include "io/output_place.h"
#include "io/sha256.h"

namespace strata::server {

tl::unexpected<Error> FailSystem(const std::string& name, const std::string& what, int error) {
  const ErrorCode code = error == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo;
  return Fail(code, name + ": " + what + ": " + io::SystemReason(error));
}

Result<Fd> OpenFolder(int parent, const std::string& name) {
  const bool made = mkdirat(parent, name.c_str(), 0700) == 0;
  if (!made && errno != EEXIST) return FailSystem(name, "cannot make the folder", errno);
  Fd folder(openat(parent, name.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!folder) return FailSystem(name, "cannot open the folder", errno);
  if (!made) return folder;
  const Fd above(openat(folder.get(), "..", O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (above) {
    if (auto synced = SyncFolder(above, name); !synced) return Forward(synced);
  }
  return folder;
}

Result<void> SyncFolder(const Fd& folder, const std::string& name) {
  // Some file systems refuse to sync a folder with EINVAL: they have no need of it.
  if (fsync(folder.get()) == 0 || errno == EINVAL) return {};
  return FailSystem(name, "cannot sync the folder to disk", errno);
}

Result<void> ForEachName(int folder, const std::function<void(const std::string&)>& use) {
  const int fd = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  DIR* entries = fd < 0 ? nullptr : fdopendir(fd);
  if (entries == nullptr) {
    const int error = errno;
    if (fd >= 0) close(fd);
    return FailSystem("a folder of the data folder", "cannot be listed", error);
  }
  std::vector<std::string> names;
  while (const dirent* entry = readdir(entries)) {
    const std::string name = entry->d_name;
    if (name != "." && name != "..") names.push_back(name);
  }
  closedir(entries);
  for (const std::string& name : names) use(name);
  return {};
}

Result<std::uint64_t> RegularFileSize(int fd, const std::string& name) {
  struct stat status;
  if (fstat(fd, &status) != 0) return FailSystem(name, "cannot be looked at", errno);
  if (!S_ISREG(status.st_mode)) return Fail(ErrorCode::kUnsupported, name + ": no regular file");
  return static_cast<std::uint64_t>(status.st_size);
}

Result<void> ReadFileAt(int fd, std::uint64_t offset, std::span<char> out,
                        const std::string& name) {
  while (!out.empty()) {
    const ssize_t n = pread(fd, out.data(), out.size(), static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    const std::string what = "byte " + std::to_string(offset) + ": cannot read";
    if (n < 0) return FailSystem(name, what, errno);
    if (n == 0) return Fail(ErrorCode::kIo, name + ": " + what + ": the file ends before");
    offset += static_cast<std::uint64_t>(n);
    out = out.subspan(static_cast<std::size_t>(n));
  }
  return {};
}

Result<std::string> HashFile(int fd, std::uint64_t size, const std::string& name) {
  io::Hasher hasher;
  std::vector<char> buffer(std::min<std::uint64_t>(size, 1 << 20));
  for (std::uint64_t offset = 0; offset < size;) {
    const std::span<char> part(buffer.data(),
                               std::min<std::uint64_t>(buffer.size(), size - offset));
    if (auto read = ReadFileAt(fd, offset, part, name); !read) return Forward(read);
    hasher.Update(part);
    offset += part.size();
  }
  std::string hash = hasher.HexDigest();
  if (!IsHash(hash)) return Fail(ErrorCode::kInternal, name + ": no SHA-256");
  return hash;
}

std::string RandomId() {
  std::array<unsigned char, 16> bytes{};
  // Of up to 256 bytes getrandom never gives fewer, and only before the system has gathered any
  // entropy does it wait.
  while (getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
  }
  std::string id;
  for (const unsigned char byte : bytes) {
    id += "0123456789abcdef"[byte >> 4];
    id += "0123456789abcdef"[byte & 15];
  }
  return id;
}

bool IsHex(std::string_view text, std::size_t digits) {
  return text.size() == digits &&
         text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

}  // namespace strata::server
