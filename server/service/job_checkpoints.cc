#include "server/service/job_checkpoints.h"

#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <set>

#include "core/version.h"
#include "io/job_folder.h"
#include "io/output_place.h"
#include "io/sha256.h"

namespace strata::server {

Result<std::unique_ptr<JobCheckpoints>> JobCheckpoints::Open(Store& store) {
  const std::string folder = store.folder().path() + "/checkpoints";
  if (mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    return Fail(ErrorCode::kIo, folder + ": cannot make it: " + io::SystemReason(errno));
  }
  std::unique_ptr<JobCheckpoints> checkpoints(new JobCheckpoints(folder));
  if (auto swept = checkpoints->Sweep(store); !swept) return Forward(swept);
  return checkpoints;
}

std::string JobCheckpoints::KeyOf(const Job& job) {
  std::string text(kVersion);
  for (const std::string& part : {job.id, job.request.model_hash, job.request.options}) {
    text += '\n' + part;
  }
  return io::Sha256Hex(text).substr(0, 32);
}

bool JobCheckpoints::Has(const std::string& key) const {
  return std::ranges::count(io::JobKeysIn(folder_), key) > 0;
}

void JobCheckpoints::Remove(const std::string& key) const {
  const auto job = io::JobFolder::Open(folder_, key, /*go_on=*/true);
  if (job) (*job)->Finish();
}

Result<void> JobCheckpoints::Sweep(Store& store) const {
  const std::vector<std::string> keys = io::JobKeysIn(folder_);
  if (keys.empty()) return {};
  std::set<std::string> wanted;
  JobQuery query;
  query.states = {JobState::kQueued, JobState::kRunning};
  query.size = 1000;
  do {
    const auto page = store.jobs().List(query);
    if (!page) return Forward(page);
    for (const Job& job : page->jobs) wanted.insert(KeyOf(job));
    query.page_token = page->next;
  } while (!query.page_token.empty());
  for (const std::string& key : keys) {
    if (!wanted.contains(key)) Remove(key);
  }
  return {};
}

}  // namespace strata::server
