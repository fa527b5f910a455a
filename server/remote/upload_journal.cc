#include "server/remote/upload_journal.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <sstream>

#include "io/output_place.h"

namespace strata::server {
namespace {

/// "BUCKET KEY ID", each percent-encoded: keys may hold blanks and line ends.
std::string LineOf(const S3Name& name, const std::string& id) {
  return name.bucket + ' ' + PercentEncode(name.key, true) + ' ' + PercentEncode(id, false);
}

}  // namespace

Result<std::unique_ptr<UploadJournal>> UploadJournal::Open(const std::string& path) {
  std::unique_ptr<UploadJournal> journal(new UploadJournal);
  journal->path_ = path;
  std::ifstream file(path);
  std::vector<std::string> open;
  std::string line;
  for (; std::getline(file, line) && !file.eof(); line.clear()) {
    const std::string entry = line.substr(std::min<std::size_t>(line.size(), 6));
    if (line.starts_with("begin ")) open.push_back(entry);
    if (line.starts_with("ended ")) std::erase(open, entry);
  }
  journal->torn_ = !open.empty() && !line.empty();
  for (const std::string& entry : open) {
    std::istringstream words(entry);
    std::string bucket, key, id;
    if (!(words >> bucket >> key >> id)) continue;
    const Result<std::string> plain_key = PercentDecode(key);
    const Result<std::string> plain_id = PercentDecode(id);
    if (plain_key && plain_id) journal->leftovers_.push_back({{bucket, *plain_key}, *plain_id});
  }
  journal->file_ =
      io::Fd(open.empty() ? ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666)
                          : ::open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC));
  if (!journal->file_) {
    return Fail(ErrorCode::kIo,
                path + ": cannot open the journal of uploads: " + io::SystemReason(errno));
  }
  return journal;
}

Result<int> UploadJournal::AbortLeftovers(S3Client& client) {
  int aborted = 0;
  for (; !leftovers_.empty(); leftovers_.pop_back(), ++aborted) {
    const Entry& entry = leftovers_.back();
    const Result<void> done = client.AbortUpload(entry.name, entry.id);
    if (!done) return Forward(done);
    Ended(entry.name, entry.id);
  }
  return aborted;
}

Result<void> UploadJournal::Append(const std::string& line) {
  const std::lock_guard lock(mutex_);
  std::uint64_t written = 0;
  // A part of a line may stand at the end, of one that was killed or of a disk that was full.
  int error = io::WriteAll(file_.get(), (torn_ ? "\n" : "") + line + '\n', written);
  torn_ = error != 0;
  if (error == 0 && fdatasync(file_.get()) != 0) error = errno;
  if (error == 0) return {};
  return Fail(ErrorCode::kIo,
              path_ + ": cannot write the journal of uploads: " + io::SystemReason(error));
}

Result<void> UploadJournal::Began(const S3Name& name, const std::string& id) {
  return Append("begin " + LineOf(name, id));
}

void UploadJournal::Ended(const S3Name& name, const std::string& id) {
  // If this is lost, the next process aborts an upload that is gone, which does no harm.
  static_cast<void>(Append("ended " + LineOf(name, id)));
}

}  // namespace strata::server
