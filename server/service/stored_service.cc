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
    if (const auto checked = store_->Check();
        !checked && checked.error().code == ErrorCode::kUnsupported) {
      claiming_ = false;
    }
    lock.lock();
  }
}

// --- Results -------------------------------------------------------------------------------------

Answer<Sampled> StoredService::SampleModel(const v1::SampleOptions& options,
                                           const std::string& model, const JobWatch& watch) {
  const auto opened = store_->models().Open(model);
  if (!opened) return Refuse(opened.error());
  return SampleOpened(options, *opened, watch);
}

Answer<Sampled> StoredService::SampleOpened(const v1::SampleOptions& options,
                                            const OpenModel& model, const JobWatch& watch) {
  const auto canonical = Canonical(options);
  if (!canonical) return Refuse(canonical.error());
  const std::string key = ResultKeyOf(*canonical, model.info.hash);
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

Answer<Sampled> StoredService::Lead(const v1::SampleOptions& options, const OpenModel& model,
                                    const JobWatch& watch, ResultLead lead) {
  auto sampled = service_.Sample(options, model.fd.get(), model.info.name, watch);
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
  auto pin = Keep(store_->blobs(), sampled->content);
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
