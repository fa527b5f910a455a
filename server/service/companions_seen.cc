#include "server/service/companions_seen.h"

#include <sys/stat.h>

#include <filesystem>
#include <utility>

#include "server/service/file_stamp.h"

namespace strata::server {
namespace {

constexpr std::size_t kMostFiles = 1000;

}  // namespace

CompanionsSeen::CompanionsSeen(std::string folder)
    : folder_(std::move(folder)), files_(io::FilesInFolder(folder_)) {}

Result<std::unique_ptr<io::ByteSource>> CompanionsSeen::Open(const std::string& relative,
                                                             const std::string& who) const {
  Note(relative);  // Before: a change while it is read is one.
  return files_->Open(relative, who);
}

void CompanionsSeen::Note(const std::string& relative) const {
  std::string path = std::filesystem::path(relative).lexically_normal().string();
  Seen seen;
  struct stat status {};
  if (stat((folder_ + '/' + path).c_str(), &status) == 0) {
    seen = {static_cast<std::uint64_t>(status.st_size), StampOf(status)};
  }
  const std::lock_guard lock(mutex_);
  // The first look counts: later ones are passes over the same mesh.
  if (seen_.size() < kMostFiles) seen_.try_emplace(std::move(path), std::move(seen));
}

void CompanionsSeen::AddTo(internal::WorkerFigures& figures) const {
  const std::lock_guard lock(mutex_);
  for (const auto& [path, seen] : seen_) {
    internal::Companion& companion = *figures.add_companions();
    companion.set_path(path);
    companion.set_bytes(seen.bytes);
    companion.set_stamp(seen.stamp);
  }
}

}  // namespace strata::server
