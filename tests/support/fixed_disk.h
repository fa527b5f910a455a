// A disk of fixed size, to be filled.
#pragma once

#include <sys/mount.h>

#include <cerrno>
#include <cstdint>
#include <string>
#include <system_error>

#include "tests/support/process.h"

namespace strata::test {

/// A tmpfs on a folder of its own, for as long as it lives. Only root may mount one.
class FixedDisk {
 public:
  explicit FixedDisk(std::uint64_t bytes) {
    const std::string options = "size=" + std::to_string(bytes);
    const std::string place = folder_.path().string();
    if (mount("tmpfs", place.c_str(), "tmpfs", MS_NOSUID | MS_NODEV, options.c_str()) != 0) {
      failure_ = "cannot mount a tmpfs: " + std::generic_category().message(errno);
    }
  }
  ~FixedDisk() {
    if (failure_.empty()) umount2(folder_.path().c_str(), MNT_DETACH);
  }
  FixedDisk(const FixedDisk&) = delete;
  FixedDisk& operator=(const FixedDisk&) = delete;

  /// Why there is none; empty when there is.
  const std::string& failure() const { return failure_; }
  std::string path() const { return folder_.path().string(); }
  std::string operator/(const std::string& name) const { return folder_ / name; }
  /// Names of what lies on it, sorted, hidden files too.
  std::vector<std::string> Names() const { return folder_.Names(); }

 private:
  ScratchFolder folder_;
  std::string failure_;
};

}  // namespace strata::test
