#include "server/store/store.h"

#include <utility>

#include "server/store/bucket_claim.h"
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

Result<void> Store::OpenDatabase() {
  if (options_.shared) return OpenShared();
  if (auto opened = Take(DataFolder::Open(options_.data), folder_); !opened) return opened;
  auto opened = Take(Database::Open(folder_->database_path(), *clock_), database_);
  if (!opened) return opened;
  return Migrate(*database_);
}

Result<void> Store::OpenBucket() {
  if (options_.bucket) {
    auto opened = Take(options_.bucket(options_.data), place_);
    if (!opened) return opened;
    auto folder = folder_->OpenCache();
    if (!folder) return Forward(folder);
    auto cached = Take(BlobCache::Open(*std::move(folder), options_.blobs.cache_bytes,
                                       options_.blobs.keep_free_bytes),
                       cache_);
    if (!cached) return cached;
  }
  return ClaimBucket(*database_, place_.get());
}

Result<void> Store::OpenFiles() {
  if (auto opened = OpenDatabase(); !opened) return opened;
  if (auto opened = OpenBucket(); !opened) return opened;
  const Milliseconds lease = options_.shared ? options_.shared->lease : Milliseconds(0);
  if (auto joined = Take(Membership::Join(*database_, lease), membership_); !joined) return joined;
  if (options_.models.empty()) return {};
  return Take(ModelRepository::Open(options_.models), repository_);
}

Result<void> Store::OpenShared() {
  const PostgresOptions& postgres = options_.shared->postgres;
  if (auto opened = Take(OpenPostgres(postgres), database_); !opened) return opened;
  if (postgres.clock == nullptr) {
    database_clock_ = std::make_unique<DatabaseClock>(*database_);
    if (auto asked = database_clock_->Refresh(); !asked) return asked;
    clock_ = database_clock_.get();
  }
  const auto store = MigrateShared(*database_, postgres.schema);
  if (!store) return Forward(store);
  if (options_.bucket) return Take(DataFolder::OpenOwn(options_.data), folder_);
  auto opened = Take(DataFolder::OpenShared(options_.data, store->id, store->has_folder), folder_);
  if (!opened || store->has_folder) return opened;
  auto noted = database_->Read().Run("UPDATE meta SET folder = 1");
  if (!noted) return Forward(noted);
  return {};
}

Result<void> Store::OpenStores() {
  const BlobBucket bucket{place_.get(), cache_.get()};
  if (auto o =
          Take(BlobStore::Open(*folder_, *database_, *membership_, options_.blobs, bucket), blobs_);
      !o) {
    return o;
  }
  models_ = std::make_unique<ModelStore>(*blobs_, *database_, repository_.get(), *clock_);
  const UploadStore::Parts uploads{*folder_, *database_, *blobs_, *models_, *clock_};
  if (auto o = Take(UploadStore::Open(uploads, options_.uploads), uploads_); !o) return o;
  const JobStore::Parts jobs{*database_, *blobs_, *clock_};
  if (auto o = Take(JobStore::Open(jobs, options_.jobs), jobs_); !o) return o;
  if (auto o = Take(ResultCache::Open({*database_, *blobs_, *clock_}), results_); !o) return o;
  swept_ = std::chrono::steady_clock::now();
  Listen();
  return {};
}

void Store::Listen() {
  Listening listening;
  listening.told = [this](const std::string& channel, const std::string& text) {
    if (channel == "jobs") jobs_->HearOfJob(text);
    if (channel == "queue") jobs_->HearOfQueue();
    if (channel == "uploads") uploads_->StopAppend(text);
    if (channel == "flights") results_->HearOfFlight(text);
  };
  listening.look = [this] {
    jobs_->Look();
    results_->Look();
  };
  listener_ = database_->Listen(std::move(listening));
}

Result<void> Store::CheckDatabase() {
  if (options_.shared) return CheckShared(*database_);
  auto asked = database_->Read().Query("SELECT 1", [](const Row&) {});
  if (!asked) return Forward(asked);
  return {};
}

Result<void> Store::Check() {
  if (auto checked = CheckDatabase(); !checked) return checked;
  return place_ ? place_->Check() : Result<void>();
}

// Every process sweeps: which one finds a dead one first does not matter.
Result<void> Store::MaintainShared() {
  // A list of a bucket costs money.
  const auto sweep_every = place_ ? std::chrono::minutes(60) : std::chrono::minutes(10);
  if (auto renewed = membership_->Renew(); !renewed) return renewed;
  if (database_clock_) static_cast<void>(database_clock_->Refresh());
  const auto expired = membership_->ExpireOthers();
  if (!expired) return Forward(expired);
  const auto now = std::chrono::steady_clock::now();
  if (*expired == 0 && now - swept_ < sweep_every) return {};
  swept_ = now;
  if (!place_) return blobs_->RemoveLeftovers();
  sweep_is_due_ = true;
  return {};
}

Result<void> Store::Maintain() {
  Result<void> result;
  const auto note = [&result](const auto& done) {
    if (!done && result) result = Forward(done);
  };
  if (options_.shared) {
    note(MaintainShared());
    // The others would wait for the database in turn; they find it next time.
    if (!result && IsDatabaseAway(result.error())) return result;
  }
  if (!place_) note(uploads_->RemoveExpired());
  note(jobs_->ExpireLeases());
  note(jobs_->Purge(clock_->Now() - options_.job_retention));
  note(results_->Flush());
  note(blobs_->CollectAll());
  return result;
}

Result<void> Store::TendBucket() {
  if (!place_) return {};
  if (auto checked = place_->Check(); !checked) return checked;
  if (auto removed = uploads_->RemoveExpired(); !removed) return Forward(removed);
  auto swept = blobs_->SweepGarbage();
  if (!swept && !IsObjectRefused(swept.error())) return swept;
  if (!sweep_is_due_.exchange(false)) return swept;
  auto removed = blobs_->RemoveLeftovers();
  // What is refused stays so for a while, and a list costs money.
  if (!removed && !IsObjectRefused(removed.error())) sweep_is_due_ = true;
  return removed ? swept : removed;
}

}  // namespace strata::server
