// What a killed process left half uploaded, from a file beside its other state.
#pragma once

#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core/result.h"
#include "io/fd.h"
#include "server/remote/s3_client.h"

namespace strata::server {

/// The uploads in parts that are under way, in a file. Whoever opens it must hold the lock of the
/// folder it lies in: then those that stand there without an end are a dead process's.
///
/// An upload whose process died between the store's answer and the line of the journal is not in
/// it; S3Client::AbortStaleUploads finds it a day later.
/// Threads: any. Memory: what is under way.
class UploadJournal : public UploadLog {
 public:
  /// Makes the file if it is missing. Errors: kIo. A torn last line is ignored.
  static Result<std::unique_ptr<UploadJournal>> Open(const std::string& path);

  /// An upload that was begun.
  struct Entry {
    S3Name name;
    std::string id;
  };
  /// What the former owner left.
  const std::vector<Entry>& leftovers() const { return leftovers_; }

  /// Aborts what the former owner left, and forgets it. Errors: the first of the client; the rest
  /// stays for the next time.
  Result<int> AbortLeftovers(S3Client& client);

  Result<void> Began(const S3Name& name, const std::string& id) override;
  void Ended(const S3Name& name, const std::string& id) override;

 private:
  UploadJournal() = default;
  Result<void> Append(const std::string& line);

  std::string path_;
  std::vector<Entry> leftovers_;
  std::mutex mutex_;
  // Guarded by mutex_:
  io::Fd file_;
  bool torn_ = false;  // The file may end in the middle of a line.
};

}  // namespace strata::server
