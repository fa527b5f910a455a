#include "server/batch/owner.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <string_view>
#include <utility>

#include "io/output_place.h"

namespace strata::server {
namespace {

tl::unexpected<Error> FailSystem(const std::string& name, int error) {
  return Fail(ErrorCode::kIo, name + ": " + io::SystemReason(error));
}

std::string HolderOf(const io::Fd& file) {
  std::array<char, 32> text;
  const ssize_t n = pread(file.get(), text.data(), text.size(), 0);
  std::string_view pid(text.data(), n > 0 ? static_cast<std::size_t>(n) : 0);
  pid = pid.substr(0, pid.find('\n'));
  return pid.empty() ? "another process" : "process " + std::string(pid);
}

void WriteHolder(const io::Fd& file) {
  const std::string pid = std::to_string(getpid()) + '\n';
  if (ftruncate(file.get(), 0) != 0) return;  // It is for people: without it nothing is lost.
  static_cast<void>(pwrite(file.get(), pid.data(), pid.size(), 0) < 0);
}

/// Opens and locks `name`; `operation` is flock's.
Result<io::Fd> Lock(const std::string& folder, const std::string& name, int operation) {
  const std::string path = folder + '/' + name;
  io::Fd file(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666));
  if (!file) return FailSystem(path, errno);
  if (flock(file.get(), operation | LOCK_NB) == 0) {
    WriteHolder(file);
    return file;
  }
  if (errno == EWOULDBLOCK) {
    return Fail(ErrorCode::kConflict, folder + ": a batch is at work here: " + HolderOf(file));
  }
  if (errno == ENOTSUP || errno == ENOSYS || errno == ENOLCK) return io::Fd();
  return FailSystem(path, errno);
}

}  // namespace

Result<Owner> Owner::Take(const std::string& folder, const std::string& share) {
  const std::string hidden = folder + "/.strata";
  if (mkdir(hidden.c_str(), 0777) != 0 && errno != EEXIST) return FailSystem(hidden, errno);
  Owner owner;
  auto whole = Lock(hidden, "lock", share.empty() ? LOCK_EX : LOCK_SH);
  if (!whole) return Forward(whole);
  owner.whole_ = *std::move(whole);
  if (!share.empty()) {
    auto part = Lock(hidden, "lock-" + share, LOCK_EX);
    if (!part) return Forward(part);
    owner.share_ = *std::move(part);
  }
  owner.mark_ = hidden + (share.empty() ? "/running" : "/running-" + share);
  const io::Fd mark(open(owner.mark_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666));
  owner.former_was_killed_ = !mark && errno == EEXIST;
  return owner;
}

void Owner::Finish() { unlink(mark_.c_str()); }

}  // namespace strata::server
