// A job's folder in scratch space: what `--resume` goes on from.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/checkpoint.h"
#include "core/result.h"

namespace strata::io {

/// `strata-job-<32 hex digits>` in a scratch directory, locked while its process lives; made when
/// the job first needs it. Where it cannot be made or belongs to somebody else (the same job
/// running twice, say), the job works without a name and without checkpoints.
///
/// A checkpoint survives the process, not the machine: nothing is synced to disk.
class JobFolder : public CheckpointPlace {
 public:
  /// `key`: 32 hex digits, the same for jobs that come to the same runs. With `go_on`, what a
  /// former process left is taken over, and a job that fails leaves its own; without, nothing is
  /// left but by a process that is killed. Errors: kIo.
  static Result<std::unique_ptr<JobFolder>> Open(const std::string& directory,
                                                 const std::string& key, bool go_on);
  ~JobFolder() override;
  JobFolder(const JobFolder&) = delete;
  JobFolder& operator=(const JobFolder&) = delete;

  Result<std::unique_ptr<ScratchFile>> OpenRuns(std::uint64_t keep) override;
  Result<std::optional<std::string>> Load() override;
  Result<void> Save(std::string_view bytes) override;
  /// The job is done: its folder goes, whatever Open was told.
  void Finish() { keep_ = false; }

 private:
  JobFolder(std::string directory, const std::string& key, int parent, bool keep);
  void Create();
  bool TakeOver();
  tl::unexpected<Error> FailIo(const std::string& what) const;

  std::string directory_, name_;
  int parent_;
  int fd_ = -1;  // The folder itself; holds the lock.
  bool keep_;
};

/// The keys of the jobs that have a folder in `directory`.
std::vector<std::string> JobKeysIn(const std::string& directory);

/// Removes the jobs' folders in `directory` whose processes are dead.
void RemoveAbandonedJobs(const std::string& directory);

}  // namespace strata::io
