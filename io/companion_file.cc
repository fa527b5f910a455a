#include "io/companion_file.h"

#include <fcntl.h>
#include <linux/openat2.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <optional>
#include <string_view>
#include <system_error>
#include <utility>

#include "io/fd.h"
#include "io/quote.h"

namespace strata::io {
namespace {

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

std::string Unescaped(const std::string& uri) {
  std::string path;
  for (std::size_t i = 0; i < uri.size(); ++i) {
    const bool escape = uri[i] == '%' && i + 2 < uri.size() && HexDigit(uri[i + 1]) >= 0 &&
                        HexDigit(uri[i + 2]) >= 0;
    if (!escape) {
      path += uri[i];
      continue;
    }
    path += static_cast<char>(HexDigit(uri[i + 1]) * 16 + HexDigit(uri[i + 2]));
    i += 2;
  }
  return path;
}

// A letter, letters or digits, a colon: "http:", "c:".
bool HasScheme(std::string_view uri) {
  const std::size_t colon = uri.find(':');
  return colon != uri.npos && colon < uri.find_first_of("/?#");
}

// Why a path is not one below the folder; null if it is.
const char* FaultOf(std::string_view path) {
  if (path.empty()) return "is empty";
  if (path.find('\0') != path.npos) return "holds a NUL";
  if (path.front() == '/') return "starts at the root";
  if (path.back() == '/') return "names a folder";
  for (std::size_t begin = 0; begin <= path.size();) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    if (path.substr(begin, end - begin) == "..") return "leads out of the folder";
    begin = end + 1;
  }
  return nullptr;
}

tl::unexpected<Error> Refuse(const std::string& who, const std::string& found, const char* why) {
  return Fail(ErrorCode::kUnsupported, who + ": the reference " + Quoted(found) + ' ' + why +
                                           "; only files in the mesh's folder are opened");
}

// What openat2 does, for systems without it: no symbolic link at all.
int OpenWithoutLinks(const Fd& folder, std::string_view path) {
  Fd at(::fcntl(folder.get(), F_DUPFD_CLOEXEC, 0));
  for (;;) {
    const std::size_t slash = path.find('/');
    const std::string part(path.substr(0, slash));
    const bool last = slash == path.npos;
    const int flags = O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK | (last ? 0 : O_DIRECTORY);
    const int next = part.empty() ? ::fcntl(at.get(), F_DUPFD_CLOEXEC, 0)
                                  : ::openat(at.get(), part.c_str(), flags);
    if (next < 0 || last) return next;
    at = Fd(next);
    path.remove_prefix(slash + 1);
  }
}

int OpenBeneath(const Fd& folder, const std::string& path) {
  // A FIFO must not make opening wait.
  struct open_how how {};
  how.flags = O_RDONLY | O_CLOEXEC | O_NONBLOCK;
  how.resolve = RESOLVE_BENEATH | RESOLVE_NO_MAGICLINKS;
  for (int attempt = 0; attempt < 16; ++attempt) {
    const long fd = ::syscall(SYS_openat2, folder.get(), path.c_str(), &how, sizeof(how));
    // EAGAIN: something was renamed on the way, and beneath could not be made sure of.
    if (fd >= 0 || (errno != EAGAIN && errno != EINTR)) {
      if (fd < 0 && (errno == ENOSYS || errno == EPERM)) return OpenWithoutLinks(folder, path);
      return static_cast<int>(fd);
    }
  }
  return -1;
}

class FolderFiles : public CompanionFiles {
 public:
  explicit FolderFiles(std::string folder) : folder_(std::move(folder)) {}

  Result<std::unique_ptr<ByteSource>> Open(const std::string& relative,
                                           const std::string& who) const override {
    const Fd at(::open(folder_.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC));
    Fd fd(at ? OpenBeneath(at, relative) : -1);
    if (!fd) return Refused(relative, who, errno);
    struct stat status {};
    if (::fstat(fd.get(), &status) != 0 || !S_ISREG(status.st_mode)) {
      return Refuse(who, relative, "is no regular file");
    }
    const std::string name = folder_ == "." ? relative : folder_ + '/' + relative;
    return OpenByteSource(std::move(fd), name, nullptr);
  }

 private:
  tl::unexpected<Error> Refused(const std::string& relative, const std::string& who,
                                int error) const {
    if (error == EXDEV || error == ELOOP) {
      return Refuse(who, relative, "leads out of the folder through a symbolic link");
    }
    const bool ours = error == EMFILE || error == ENFILE || error == ENOMEM || error == EIO;
    return Fail(ours ? ErrorCode::kIo : ErrorCode::kNotFound,
                who + ": the file " + Quoted(relative) + " in " + Quoted(folder_) +
                    " cannot be opened: " + std::generic_category().message(error));
  }

  std::string folder_;
};

}  // namespace

Result<std::string> RelativePath(const std::string& uri, const std::string& who) {
  if (HasScheme(uri)) return Refuse(who, uri, "names a scheme");
  std::string path = Unescaped(uri);
  if (path.find('\\') != path.npos) return Refuse(who, uri, "holds a backslash");
  if (const char* fault = FaultOf(path)) return Refuse(who, uri, fault);
  return path;
}

Result<std::string> RelativePathOfName(const std::string& name, const std::string& who) {
  std::string path = name;
  std::replace(path.begin(), path.end(), '\\', '/');
  if (HasScheme(path)) return Refuse(who, name, "names a drive or scheme");
  if (const char* fault = FaultOf(path)) return Refuse(who, name, fault);
  return path;
}

std::shared_ptr<const CompanionFiles> FilesInFolder(std::string folder) {
  return std::make_shared<FolderFiles>(std::move(folder));
}

Result<std::unique_ptr<ByteSource>> OpenCompanion(
    const std::shared_ptr<const CompanionFiles>& companions, const std::string& relative,
    const std::string& who) {
  if (companions != nullptr) return companions->Open(relative, who);
  return Fail(ErrorCode::kUnsupported, who + ": needs the file " + Quoted(relative) +
                                           ", and this input has no folder; expected a file that "
                                           "holds everything");
}

}  // namespace strata::io
