#include "server/batch/saved_files.h"

#include <fstream>
#include <memory>
#include <utility>

#include "io/atomic_file.h"
#include "server/remote/s3_name.h"

namespace strata::server {

void SavedFiles::Load(const std::string& path) {
  path_ = path;
  std::ifstream file(path);
  for (std::string name, stamp, etag; file >> name >> stamp >> etag;) {
    const Result<std::string> plain = PercentDecode(name);
    if (plain) entries_[*plain] = {stamp, etag};
  }
}

Result<void> SavedFiles::Store() const {
  Result<std::unique_ptr<io::AtomicFile>> file = io::AtomicFile::Open(path_);
  if (!file) return Forward(file);
  for (const auto& [name, entry] : entries_) {
    const std::string line =
        PercentEncode(name, true) + ' ' + entry.stamp + ' ' + entry.etag + '\n';
    if (Result<void> written = (*file)->Write(line); !written) return written;
  }
  const Result<std::uint64_t> done = (*file)->Finish();
  return done ? Result<void>() : Forward(done);
}

const SavedFiles::Entry* SavedFiles::Find(const std::string& name) const {
  const auto found = entries_.find(name);
  return found != entries_.end() ? &found->second : nullptr;
}

void SavedFiles::Set(const std::string& name, Entry entry) {
  if (entry.etag.empty()) entry.etag = "-";  // Of a store without tags.
  entries_[name] = std::move(entry);
}

}  // namespace strata::server
