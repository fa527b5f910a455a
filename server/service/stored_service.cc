#include "server/service/stored_service.h"

#include <algorithm>
#include <array>
#include <utility>

#include "core/version.h"
#include "server/service/canonical_options.h"
#include "server/service/log.h"
#include "server/service/stored_results.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kMaintainEvery{5000};
constexpr std::chrono::milliseconds kAskAgain{1000};

/// Copies a result into the store, hashed as it passes.
Result<BlobPin> Keep(BlobStore& blobs, const Content& content) {
  auto writer = blobs.NewBlob(BlobKind::kResult, content.size);
  if (!writer) return Forward(writer);
  std::vector<char> piece(std::min<std::uint64_t>(content.size, 1 << 20));
  for (std::uint64_t at = 0; at < content.size;) {
    const std::size_t now = std::min<std::uint64_t>(piece.size(), content.size - at);
    if (auto read = content.read(at, {piece.data(), now}); !read) return Forward(read);
    if (auto written = writer->Write({piece.data(), now}); !written) return Forward(written);
    at += now;
  }
  return writer->Commit();
}

Answer<Sampled> SampledOf(CachedResult cached, bool was_there) {
  Sampled sampled;
  if (auto parsed = FromJson(cached.summary, sampled.summary); !parsed) {
    return Refuse(parsed.error());
  }
  sampled.content = ContentOf(std::move(cached.content), cached.media_type);
  sampled.summary.set_etag(sampled.content.etag);
  sampled.summary.set_cached(was_there);
  return sampled;
}

}  // namespace

std::string ResultKeyOf(const v1::SampleOptions& canonical, const std::string& model_hash) {
  return ResultKey({model_hash, JsonOf(canonical), canonical.seed(), std::string(kVersion)});
}

Content ContentOf(BlobReader blob, const std::string& media_type) {
  Content content;
  content.size = blob.size();
  content.media_type = media_type;
  content.etag = '"' + blob.pin.hash() + '"';
  const auto shared = std::make_shared<const BlobReader>(std::move(blob));
  content.read = [shared](std::uint64_t offset, std::span<char> out) {
    return shared->ReadAt(offset, out);
  };
  return content;
}

Result<std::unique_ptr<StoredService>> StoredService::Start(const StoreOptions& options,
                                                            Service& service) {
  std::unique_ptr<StoredService> stored(new StoredService(options, service));
  auto store = Store::Open(options, stored->clock_);
  if (!store) return Forward(store);
  stored->store_ = *std::move(store);
  if (!options.shared) {
    auto checkpoints = JobCheckpoints::Open(*stored->store_);
    if (!checkpoints) return Forward(checkpoints);
    stored->checkpoints_ = *std::move(checkpoints);
  }
  StoredService& self = *stored;
  for (std::uint32_t i = 0; i < service.limits().jobs.jobs; ++i) {
    self.threads_.emplace_back([&self] { self.RunJobs(); });
  }
  self.threads_.emplace_back([&self] { self.Maintain(); });
  if (options.bucket) self.threads_.emplace_back([&self] { self.TendBucket(); });
  return stored;
}

StoredService::StoredService(const StoreOptions& options, Service& service)
    : service_(service), owner_(ProcessName()), lease_(options.jobs.lease) {}

Answer<void> StoredService::CheckReady() {
  const auto checked = store_->Check();
  if (!checked) return Refuse(Refusal::kUnavailable, checked.error().message, 5);
  return {};
}

void StoredService::StopClaiming() { claiming_ = false; }

StoredService::~StoredService() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void StoredService::Maintain() {
  // A process's own lease is renewed here.
  const auto every = std::min(kMaintainEvery, lease_ / 4);
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, every, [this] { return stopping_.load(); })) {
    lock.unlock();
    const auto done = store_->Maintain();
    const bool away = !done && IsDatabaseAway(done.error());
    if (!done && !(away && away_)) {
      Log(LogLevel::kWarning, "maintenance_failed", {{"reason", done.error().message}});
    }
    if (done && away_) Log(LogLevel::kInfo, "database_back", {});
    away_ = away;
    // What a newer Strata has migrated is not this one's to work on.
    if (const auto checked = store_->CheckDatabase();
        !checked && checked.error().code == ErrorCode::kUnsupported) {
      claiming_ = false;
    }
    lock.lock();
  }
}

void StoredService::TendBucket() {
  const Meanwhile meanwhile([this] { return stopping_.load(); });
  enum class State : std::uint8_t { kFine, kRefuses, kAway } last = State::kFine;
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, std::min(kMaintainEvery, lease_ / 2),
                         [this] { return stopping_.load(); })) {
    lock.unlock();
    const auto done = store_->TendBucket();
    if (stopping_) return;
    const bool refused = !done && IsObjectRefused(done.error());
    const State now = done ? State::kFine : refused ? State::kRefuses : State::kAway;
    // What is refused for days must not hide that the bucket is away for an hour.
    if (now != State::kAway && last == State::kAway) Log(LogLevel::kInfo, "bucket_back", {});
    if (!done && now != last) {
      Log(LogLevel::kWarning, refused ? "bucket_refuses" : "bucket_away",
          {{"reason", done.error().message}});
    }
    last = now;
    lock.lock();
  }
}

// --- Results -------------------------------------------------------------------------------------

Answer<Sampled> StoredService::SampleModel(const v1::SampleOptions& options,
                                           const std::string& model, const JobWatch& watch) {
  const Meanwhile meanwhile(watch.gone);
  const auto named = store_->models().Open(model, ModelUse::kName);
  if (!named) return Refuse(named.error());
  return SampleVersion(options, {named->info.name, named->info.hash}, watch);
}

Answer<Sampled> StoredService::SampleVersion(const v1::SampleOptions& options, const Version& model,
                                             const JobWatch& watch) {
  const auto canonical = Canonical(options);
  if (!canonical) return Refuse(canonical.error());
  const std::string key = ResultKeyOf(*canonical, model.hash);
  while (true) {
    auto answer = store_->results().Enter(key);
    if (!answer) return Refuse(answer.error());
    if (answer->hit) {
      service_.metrics().CountCache(true);
      return SampledOf(*std::move(answer->hit), true);
    }
    if (answer->lead) {
      service_.metrics().CountCache(false);
      return Lead(options, model, watch, *std::move(answer->lead));
    }
    while (!answer->wait->Wait(kTick)) {
      if ((watch.gone && watch.gone()) || service_.cancelled()) {
        return Refuse(Cancelled().value());
      }
    }
    if (const auto error = answer->wait->error()) return Refuse(*error);
  }
}

// What was computed is not lost because the bucket is away for a while; a client waits for its
// answer no longer than the bucket is asked.
Result<BlobPin> StoredService::KeepResult(const Content& content, const JobWatch& watch) {
  while (true) {
    auto kept = Keep(store_->blobs(), content);
    const bool again = !kept && IsBucketAway(kept.error()) && watch.accepted;
    if (!again) return kept;
    for (auto waited = kTick; waited < kAskAgain; waited += kTick) {
      if (watch.gone && watch.gone()) return kept;
      std::unique_lock lock(mutex_);
      wake_.wait_for(lock, kTick);
    }
  }
}

Answer<Sampled> StoredService::Lead(const v1::SampleOptions& options, const Version& version,
                                    const JobWatch& watch, ResultLead lead) {
  const auto model = store_->models().OpenVersion(version.name, version.hash);
  if (!model) return Refuse(model.error());
  auto sampled = service_.Sample(options, model->fd.get(), version.name, watch);
  if (!sampled) {
    const Problem& problem = sampled.error();
    // What is wrong with mesh or options is wrong for all who wait; a client that went, or a
    // queue that was full, is its own.
    const bool for_all = problem.code == ErrorCode::kCorruptInput ||
                         problem.code == ErrorCode::kUnsupported ||
                         problem.code == ErrorCode::kEmptySurface;
    if (for_all) lead.MarkFailed({problem.code, problem.detail});
    return sampled;
  }
  auto pin = KeepResult(sampled->content, watch);
  if (!pin) return Refuse(pin.error());
  const auto published = lead.Publish(*pin, sampled->content.media_type, JsonOf(sampled->summary));
  if (!published) return Refuse(published.error());
  auto blob = store_->blobs().OpenBlob(pin->hash());
  if (!blob) return Refuse(blob.error());
  sampled->content = ContentOf(*std::move(blob), sampled->content.media_type);
  sampled->summary.set_etag(sampled->content.etag);
  return sampled;
}

}  // namespace strata::server
