// BatchService where several processes share a store.
#include <charconv>
#include <filesystem>
#include <memory>
#include <utility>

#include "server/batch/batch_service.h"
#include "server/batch/manifest.h"
#include "server/service/canonical_options.h"
#include "server/service/log.h"
#include "server/store/file.h"
#include "server/store/page_token.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;
constexpr std::chrono::minutes kStrangersEvery{10};

BatchState StateOf(const v1::Batch& batch) {
  if (batch.state() == v1::Batch::queued) return BatchState::kQueued;
  return batch.state() == v1::Batch::running ? BatchState::kRunning : BatchState::kEnded;
}

v1::Batch BatchOf(const BatchRow& row) {
  v1::Batch batch;
  static_cast<void>(FromJson(row.text, batch));  // A row of a newer program shows what is known.
  batch.set_id(row.id);
  // Claimed a moment ago, or waiting to be taken up: its text follows.
  if (row.state == BatchState::kRunning) batch.set_state(v1::Batch::running);
  return batch;
}

}  // namespace

void BatchService::Show(const BatchRow& row) {
  const std::lock_guard lock(mutex_);
  Entry& entry = entries_[row.id];
  if (entry.claimed) {
    // What runs here is told here; the row tells of wishes, and whose it is. One that was read
    // before this process claimed it tells nothing.
    if (row.revision < entry.claimed->revision) return;
    entry.cancel = entry.cancel || row.cancel;
    entry.lost = entry.lost || row.holder != entry.claimed->holder ||
                 row.attempts != entry.claimed->attempts || row.state != BatchState::kRunning;
    return;
  }
  const auto revision = static_cast<std::uint64_t>(row.revision);
  if (entry.revision == revision && !entry.batch.id().empty()) return;
  entry.batch = BatchOf(row);
  entry.revision = revision;
  entry.cancel = row.cancel;
  entry.lost = false;
  changed_.notify_all();
}

void BatchService::Lose(const std::string& id) {
  const std::lock_guard lock(mutex_);
  entries_[id].lost = true;
}

// Whether it was another's by now. From then on its row is what is shown here.
bool BatchService::GiveUpLost(const std::string& id) {
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    if (found == entries_.end() || !found->second.lost) return false;
    found->second.claimed.reset();
    found->second.revision = 0;
  }
  Log(LogLevel::kWarning, "batch_lost", {{"id", id}});
  return true;
}

Answer<void> BatchService::Refresh(const std::string& id) {
  if (!rows_) return {};
  const auto row = rows_->Get(id);
  if (!row) return Refuse(row.error());
  if (*row) {
    Show(**row);
    return {};
  }
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found != entries_.end() && found->second.claimed) {
    found->second.lost = true;
  } else if (found != entries_.end()) {
    entries_.erase(found);
  }
  return {};
}

Answer<v1::ListBatchesResponse> BatchService::ListShared(std::size_t size,
                                                         const std::string& after) {
  std::optional<BatchRows::Place> before;
  if (!after.empty()) {
    before.emplace();
    const char* const end = after.data() + after.size();
    const auto [at, error] = std::from_chars(after.data(), end, before->created);
    if (error != std::errc() || at == end || *at != ' ') {
      return Refuse(Error{ErrorCode::kInvalidArgument, "page_token: is not one of this list"});
    }
    before->id.assign(at + 1, end);
  }
  const auto rows = rows_->List(before, size + 1);
  if (!rows) return Refuse(rows.error());
  v1::ListBatchesResponse response;
  for (std::size_t i = 0; i < std::min(size, rows->size()); ++i) {
    const std::lock_guard lock(mutex_);
    const auto own = entries_.find((*rows)[i].id);
    const bool here = own != entries_.end() && own->second.claimed && !own->second.lost;
    *response.add_batches() = here ? own->second.batch : BatchOf((*rows)[i]);
  }
  if (rows->size() > size) {
    const BatchRow& last = (*rows)[size - 1];
    response.set_next_page_token(MakePageToken('b', std::to_string(last.created) + ' ' + last.id));
  }
  return response;
}

std::string BatchService::Claim() {
  if (store_.bucket_is_away() || !service_.ready()) return {};
  const auto row = rows_->Claim();
  if (!row || !*row) return {};
  v1::Batch batch = BatchOf(**row);
  batch.set_state(v1::Batch::queued);
  {
    const std::lock_guard lock(mutex_);
    Entry& entry = entries_[batch.id()];
    entry.batch = batch;
    ++entry.revision;
    entry.cancel = (*row)->cancel;
    entry.claimed = **row;
    entry.lost = false;
  }
  if ((*row)->attempts <= options_.most_attempts) return batch.id();
  const Error error = {ErrorCode::kInternal, "the batch was begun " +
                                                 std::to_string((*row)->attempts - 1) +
                                                 " times and never ended: its processes died"};
  *batch.mutable_error() = ToMessage(ProblemOf(error), "");
  batch.set_state(v1::Batch::failed);
  *batch.mutable_ended() = Now();
  Close(batch);
  return {};
}

Result<void> BatchService::SaveShared(const v1::Batch& batch) {
  BatchRow claimed;
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(batch.id());
    if (found == entries_.end() || !found->second.claimed) {
      return Fail(ErrorCode::kConflict, "batch " + batch.id() + ": is another process's");
    }
    claimed = *found->second.claimed;
  }
  const BatchRows::Update update{StateOf(batch), JsonOf(batch)};
  const auto changed = rows_->Change(claimed, update);
  if (!changed) return Forward(changed);
  const std::lock_guard lock(mutex_);
  Entry& entry = entries_[batch.id()];
  if (!*changed) {
    entry.lost = true;
    return Fail(ErrorCode::kConflict, "batch " + batch.id() + ": is another process's by now");
  }
  if (update.state != BatchState::kRunning) {
    entry.claimed.reset();
    entry.revision = 0;  // The row's own counts from now on.
  }
  return {};
}

void BatchService::RemoveOldShared() {
  const auto old = rows_->EndedBefore(options_.retention);
  if (!old) return;
  for (const std::string& id : *old) {
    // The row last: what is cut short here is found again.
    if (!RemoveOutputs(id) || !rows_->Remove(id)) return;
    const std::lock_guard lock(mutex_);
    entries_.erase(id);
  }
  RemoveStrangers();
}

Result<void> BatchService::RemoveOutputs(const std::string& id) {
  std::error_code ignored;
  fs::remove_all(PathOf(id), ignored);
  if (!InBucket()) return {};
  ObjectPlace& place = *store_.blobs().bucket().place;
  std::vector<std::string> names;
  auto listed = place.List("batches/" + id + '/',
                           [&](const std::string& name, std::uint64_t) { names.push_back(name); });
  if (!listed) return listed;
  for (const std::string& name : names) {
    if (auto deleted = place.Delete(name); !deleted) return deleted;
  }
  return {};
}

// A folder of state of a batch that another process ended and removed.
void BatchService::RemoveStrangers() {
  const auto now = std::chrono::steady_clock::now();
  if (!InBucket() || now - strangers_removed_ < kStrangersEvery) return;
  strangers_removed_ = now;
  std::error_code failed;
  for (fs::directory_iterator at(options_.folder, failed), end; !failed && at != end;
       at.increment(failed)) {
    const std::string id = at->path().filename().string();
    if (!IsHex(id, 32)) continue;
    const auto row = rows_->Get(id);
    if (!row) return;
    std::error_code ignored;
    if (!*row) fs::remove_all(at->path(), ignored);
  }
}

Answer<Content> BatchService::OpenObject(const std::string& id, const std::string& path,
                                         const std::string& media_type) {
  ObjectPlace& place = *store_.blobs().bucket().place;
  const std::string name = "batches/" + id + '/' + path;
  // Of one version: a manifest is replaced now and then while its batch runs.
  const auto found = place.FindVersion(name);
  if (!found) return Refuse(found.error());
  if (!*found) return Refuse(Error{ErrorCode::kNotFound, path + ": not found"});
  Content content;
  content.media_type = media_type;
  const auto reader = std::make_shared<ObjectReader>(
      place, ObjectReader::Object{name, {}, (*found)->size, (*found)->tag}, [] {});
  content.read = [reader](std::uint64_t offset, std::span<char> out) {
    return reader->ReadAt(offset, out);
  };
  content.size = (*found)->size;
  if (path != "manifest.jsonl") return content;
  const auto end = EndOfLines(content.read, content.size);
  if (!end) return Refuse(end.error());
  content.size = *end;
  return content;
}

}  // namespace strata::server
