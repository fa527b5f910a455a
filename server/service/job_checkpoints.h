// What stored jobs leave for another attempt at them, should the service be killed.
#pragma once

#include <memory>
#include <string>
#include <utility>

#include "core/result.h"
#include "server/store/store.h"

namespace strata::server {

/// `checkpoints/` in the data folder, with a folder for each job that came to spill
/// (io/job_folder.h, docs/adr/0011). It is this machine's: an attempt elsewhere starts anew.
/// Threads: any.
class JobCheckpoints {
 public:
  /// Makes it, and removes what jobs left that have ended since. `store` is only used here.
  /// Errors: kIo.
  static Result<std::unique_ptr<JobCheckpoints>> Open(Store& store);

  const std::string& folder() const { return folder_; }
  /// 32 hex digits, of the job and of this version: another one's runs may be other runs.
  static std::string KeyOf(const Job& job);
  bool Has(const std::string& key) const;
  /// Unless a process has it. What is not there is removed.
  void Remove(const std::string& key) const;

 private:
  explicit JobCheckpoints(std::string folder) : folder_(std::move(folder)) {}
  Result<void> Sweep(Store& store) const;

  std::string folder_;
};

}  // namespace strata::server
