// Which files a mesh asks for beside it: whoever keeps a result must make it anew when they change.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "io/companion_file.h"
#include "strata/internal/worker.pb.h"

namespace strata::server {

/// The files of a folder (io::FilesInFolder), with a note of what was asked for, there or not.
/// Threads: any.
class CompanionsSeen final : public io::CompanionFiles {
 public:
  explicit CompanionsSeen(std::string folder);

  Result<std::unique_ptr<io::ByteSource>> Open(const std::string& relative,
                                               const std::string& who) const override;
  /// In order of the paths' bytes. Of more than 1,000 files some are left out.
  void AddTo(internal::WorkerFigures& figures) const;

 private:
  struct Seen {
    std::uint64_t bytes = 0;
    std::string stamp;
  };
  void Note(const std::string& relative) const;

  const std::string folder_;
  const std::shared_ptr<const io::CompanionFiles> files_;
  mutable std::mutex mutex_;
  mutable std::map<std::string, Seen> seen_;
};

}  // namespace strata::server
