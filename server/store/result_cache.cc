#include "server/store/result_cache.h"

#include <utility>

#include "io/sha256.h"

namespace strata::server {

std::string ResultKey(const ResultKeyParts& parts) {
  std::string text = std::to_string(parts.seed);
  for (const std::string* part : {&parts.model_hash, &parts.version, &parts.options}) {
    text += ' ' + std::to_string(part->size()) + ' ' + *part;
  }
  return io::Sha256Hex(text);
}

bool ResultWait::Wait(Milliseconds timeout) {
  std::unique_lock lock(mutex_);
  return ended_came_.wait_for(lock, timeout, [this] { return ended_; });
}

std::optional<Error> ResultWait::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

ResultLead::ResultLead(ResultLead&& other) noexcept
    : cache_(std::exchange(other.cache_, nullptr)), key_(std::move(other.key_)) {}

ResultLead::~ResultLead() {
  if (cache_ != nullptr) cache_->EndFlight(key_, std::nullopt);
}

Result<void> ResultLead::Publish(const BlobPin& blob, const std::string& media_type,
                                 const std::string& summary) {
  if (cache_ == nullptr) return Fail(ErrorCode::kInternal, "result: published twice");
  auto stored = cache_->Store(key_, blob, media_type, summary);
  std::optional<Error> error;
  if (!stored) error = stored.error();
  std::exchange(cache_, nullptr)->EndFlight(key_, error);
  return stored;
}

void ResultLead::MarkFailed(const Error& error) {
  if (cache_ != nullptr) std::exchange(cache_, nullptr)->EndFlight(key_, error);
}

Result<std::unique_ptr<ResultCache>> ResultCache::Open(const Parts& parts) {
  std::unique_ptr<ResultCache> cache(new ResultCache(parts));
  auto asked = parts.database.Read().Query("SELECT max(last_used) FROM results",
                                           [&](const Row& row) { cache->last_use_ = row.Int(0); });
  if (!asked) return Forward(asked);
  parts.blobs.SetRoomMaker([raw = cache.get()](std::uint64_t bytes) { return raw->Evict(bytes); });
  return cache;
}

ResultCache::~ResultCache() {
  parts_.blobs.SetRoomMaker({});
  (void)Flush();  // Only the order of eviction is at stake.
}

std::int64_t ResultCache::NextUse() {
  const std::lock_guard lock(uses_mutex_);
  return ++last_use_;
}

void ResultCache::Touch(const std::string& key) {
  const std::lock_guard lock(uses_mutex_);
  uses_[key] = ++last_use_;
}

Result<std::optional<ResultCache::Known>> ResultCache::FindKnown(const std::string& key) {
  std::optional<Known> known;
  auto asked = parts_.database.Read().Query(
      "SELECT blob, media_type, summary, created FROM results WHERE key = ?",
      [&](const Row& row) {
        known = Known{row.Text(0), row.Text(1), row.Text(2), FromMillis(row.Int(3))};
      },
      key);
  if (!asked) return Forward(asked);
  return known;
}

Result<std::optional<CachedResult>> ResultCache::OpenKnown(const std::string& key, Known known) {
  auto content = parts_.blobs.OpenBlob(known.hash);
  if (!content && IsStoreAway(content.error())) return Forward(content);
  // Evicted since, or damaged from outside: both are mended by computing it again.
  if (!content) return std::nullopt;
  CachedResult result;
  result.content = std::move(*content);
  result.media_type = std::move(known.media_type);
  result.summary = std::move(known.summary);
  result.created = known.created;
  Touch(key);
  return result;
}

Result<std::optional<CachedResult>> ResultCache::Lookup(const std::string& key) {
  auto known = FindKnown(key);
  if (!known) return Forward(known);
  if (!*known) return std::nullopt;
  return OpenKnown(key, std::move(**known));
}

Result<CacheAnswer> ResultCache::Enter(const std::string& key) {
  std::string broken;  // The blob that a row names and that cannot be opened.
  while (true) {
    auto known = FindKnown(key);
    if (!known) return Forward(known);
    if (*known && (*known)->hash != broken) {
      broken = (*known)->hash;
      // Without a lock: it may lie in a bucket that is slow.
      auto found = OpenKnown(key, std::move(**known));
      if (!found) return Forward(found);
      if (*found) {
        ++hits_;
        CacheAnswer answer;
        answer.hit = std::move(**found);
        return answer;
      }
    }
    auto answer = JoinOrLead(key, broken);
    if (!answer) return Forward(answer);
    if (*answer) return std::move(**answer);
  }
}

Result<std::optional<CacheAnswer>> ResultCache::JoinOrLead(const std::string& key,
                                                           const std::string& broken) {
  const std::lock_guard lock(flights_mutex_);
  std::optional<CacheAnswer> answer(std::in_place);
  if (const auto flight = flights_.find(key); flight != flights_.end()) {
    ++waits_;
    answer->wait = flight->second;
    return answer;
  }
  // With the lock: who leads stores first and ends the flight then, so a result that is not found
  // here still has its flight.
  const auto known = FindKnown(key);
  if (!known) return Forward(known);
  if (*known && (*known)->hash != broken) return std::nullopt;
  const auto leads = TakeLead(key);
  if (!leads) return Forward(leads);
  const auto flight = std::make_shared<ResultWait>();
  flights_[key] = flight;
  if (*leads) {
    ++misses_;
    answer->lead.emplace(ResultLead(this, key));
  } else {
    ++waits_;
    elsewhere_.insert(key);
    answer->wait = flight;
  }
  return answer;
}

// Whether this process computes it, among all. Its former lead, should it not have been ended, is
// as good as a new one.
Result<bool> ResultCache::TakeLead(const std::string& key) {
  if (!parts_.database.shared()) return true;
  const std::string mine = parts_.blobs.membership().id();
  auto taken = parts_.database.Read().Run(
      "INSERT INTO flights (key, process) SELECT ?1, id FROM processes WHERE id = ?2"
      " ON CONFLICT (key) DO UPDATE SET process = excluded.process WHERE flights.process = ?2",
      key, mine);
  if (!taken) return Forward(taken);
  return *taken == 1;
}

void ResultCache::HearOfFlight(const std::string& key) {
  {
    const std::lock_guard lock(flights_mutex_);
    if (!elsewhere_.contains(key)) return;
  }
  EndWaits(key, std::nullopt);
}

void ResultCache::Look() {
  std::set<std::string> waiting, unended;
  {
    const std::lock_guard lock(flights_mutex_);
    waiting = elsewhere_;
    unended.swap(unended_);
    // Led again, and to be ended by who leads.
    std::erase_if(unended, [this](const std::string& key) {
      return flights_.contains(key) && !elsewhere_.contains(key);
    });
  }
  for (const std::string& key : unended) GiveUpLead(key);
  for (const std::string& key : waiting) {
    bool flies = false;
    auto asked = parts_.database.Read().Query(
        "SELECT 1 FROM flights WHERE key = ?", [&](const Row&) { flies = true; }, key);
    if (!asked) return;
    if (!flies) HearOfFlight(key);
  }
}

void ResultCache::EndFlight(const std::string& key, const std::optional<Error>& error) {
  if (parts_.database.shared()) GiveUpLead(key);
  EndWaits(key, error);
}

void ResultCache::GiveUpLead(const std::string& key) {
  auto ended = parts_.database.Read().Run("DELETE FROM flights WHERE key = ? AND process = ?", key,
                                          parts_.blobs.membership().id());
  if (ended) return;
  // Others would wait for as long as this process lives: Look tries again.
  const std::lock_guard lock(flights_mutex_);
  unended_.insert(key);
}

void ResultCache::EndWaits(const std::string& key, const std::optional<Error>& error) {
  std::shared_ptr<ResultWait> flight;
  {
    const std::lock_guard lock(flights_mutex_);
    auto node = flights_.extract(key);
    elsewhere_.erase(key);
    if (node.empty()) return;
    flight = std::move(node.mapped());
  }
  {
    const std::lock_guard lock(flight->mutex_);
    flight->ended_ = true;
    flight->error_ = error;
  }
  flight->ended_came_.notify_all();
}

Result<void> ResultCache::Store(const std::string& key, const BlobPin& blob,
                                const std::string& media_type, const std::string& summary) {
  std::string replaced;
  {
    auto session = parts_.database.Write();
    if (!session) return Forward(session);
    auto asked = session->Query(
        "SELECT blob FROM results WHERE key = ?", [&](const Row& row) { replaced = row.Text(0); },
        key);
    if (!asked) return Forward(asked);
    auto stored = session->Run(
        "INSERT INTO results (key, blob, media_type, summary, created, last_used)"
        " VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (key) DO UPDATE SET blob = excluded.blob,"
        " media_type = excluded.media_type, summary = excluded.summary,"
        " created = excluded.created, last_used = excluded.last_used",
        key, blob.hash(), media_type, summary, ToMillis(parts_.clock.Now()), NextUse());
    if (!stored) return Forward(stored);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (!replaced.empty() && replaced != blob.hash()) parts_.blobs.Collect(replaced);
  return {};
}

Result<void> ResultCache::Flush() {
  std::unordered_map<std::string, std::int64_t> uses;
  {
    const std::lock_guard lock(uses_mutex_);
    uses.swap(uses_);
  }
  if (uses.empty()) return {};
  auto session = parts_.database.Write();
  if (!session) return Forward(session);
  for (const auto& [key, use] : uses) {
    auto updated = session->Run("UPDATE results SET last_used = ? WHERE key = ?", use, key);
    if (!updated) return Forward(updated);
  }
  return session->Commit();
}

Result<std::vector<ResultCache::Candidate>> ResultCache::Candidates() {
  std::vector<Candidate> all;
  Session session = parts_.database.Read();
  const auto now = session.Now();
  if (!now) return Forward(now);
  // In a shared store, what was touched a moment ago would keep its space for now.
  const std::int64_t before =
      parts_.database.shared() ? ToMillis(*now - parts_.blobs.grace()) : INT64_MAX;
  auto listed = session.Query(
      "SELECT key, blob, size FROM results JOIN blobs ON blobs.hash = results.blob"
      " WHERE NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.result_blob = results.blob)"
      " AND touched <= ? ORDER BY last_used",
      [&](const Row& row) {
        all.push_back({row.Text(0), row.Text(1), static_cast<std::uint64_t>(row.Int(2))});
      },
      before);
  if (!listed) return Forward(listed);
  return all;
}

bool ResultCache::Evict(std::uint64_t bytes) {
  if (!Flush()) return false;
  const auto candidates = Candidates();
  if (!candidates) return false;
  std::vector<const Candidate*> chosen;
  std::uint64_t freed = 0;
  for (const Candidate& candidate : *candidates) {
    if (freed >= bytes && !chosen.empty()) break;
    if (parts_.blobs.IsPinned(candidate.blob)) continue;
    chosen.push_back(&candidate);
    freed += candidate.size;
  }
  if (chosen.empty()) return false;
  {
    auto session = parts_.database.Write();
    if (!session) return false;
    for (const Candidate* candidate : chosen) {
      if (!session->Run("DELETE FROM results WHERE key = ?", candidate->key)) return false;
    }
    if (!session->Commit()) return false;
  }
  for (const Candidate* candidate : chosen) parts_.blobs.Collect(candidate->blob);
  evictions_ += chosen.size();
  return true;
}

Result<void> ResultCache::Remove(const std::string& key) {
  std::string blob;
  {
    auto session = parts_.database.Write();
    if (!session) return Forward(session);
    auto removed = session->Query(
        "DELETE FROM results WHERE key = ? RETURNING blob",
        [&](const Row& row) { blob = row.Text(0); }, key);
    if (!removed) return Forward(removed);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (!blob.empty()) parts_.blobs.Collect(blob);
  return {};
}

}  // namespace strata::server
