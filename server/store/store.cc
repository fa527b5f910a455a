#include "server/store/store.h"

#include <utility>

#include "server/store/schema.h"

namespace strata::server {
namespace {

// Takes what `opened` made; passes its error on.
template <class T>
Result<void> Take(Result<std::unique_ptr<T>> opened, std::unique_ptr<T>& place) {
  if (!opened) return Forward(opened);
  place = std::move(*opened);
  return {};
}

}  // namespace

Result<std::unique_ptr<Store>> Store::Open(const StoreOptions& options, const Clock& clock) {
  std::unique_ptr<Store> store(new Store(options, clock));
  if (auto opened = store->OpenFiles(); !opened) return Forward(opened);
  if (auto opened = store->OpenStores(); !opened) return Forward(opened);
  return store;
}

Result<void> Store::OpenFiles() {
  if (auto opened = Take(DataFolder::Open(options_.data), folder_); !opened) return opened;
  if (auto opened = Take(Database::Open(folder_->database_path()), database_); !opened) {
    return opened;
  }
  if (auto migrated = Migrate(*database_); !migrated) return migrated;
  if (options_.models.empty()) return {};
  return Take(ModelRepository::Open(options_.models), repository_);
}

Result<void> Store::OpenStores() {
  if (auto o = Take(BlobStore::Open(*folder_, *database_, options_.blobs), blobs_); !o) return o;
  models_ = std::make_unique<ModelStore>(*blobs_, *database_, repository_.get(), clock_);
  const UploadStore::Parts uploads{*folder_, *database_, *blobs_, *models_, clock_};
  if (auto o = Take(UploadStore::Open(uploads, options_.uploads), uploads_); !o) return o;
  const JobStore::Parts jobs{*database_, *blobs_, clock_};
  if (auto o = Take(JobStore::Open(jobs, options_.jobs), jobs_); !o) return o;
  return Take(ResultCache::Open({*database_, *blobs_, clock_}), results_);
}

Result<void> Store::Maintain() {
  Result<void> result;
  const auto note = [&result](const auto& done) {
    if (!done && result) result = Forward(done);
  };
  note(uploads_->RemoveExpired());
  note(jobs_->ExpireLeases());
  note(jobs_->Purge(clock_.Now() - options_.job_retention));
  note(results_->Flush());
  note(blobs_->CollectAll());
  return result;
}

}  // namespace strata::server
