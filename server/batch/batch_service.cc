#include "server/batch/batch_service.h"

#include <fcntl.h>
#include <google/protobuf/util/time_util.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>
#include <vector>

#include "io/atomic_file.h"
#include "io/output_place.h"
#include "server/batch/manifest.h"
#include "server/service/canonical_options.h"
#include "server/service/wire_options.h"
#include "server/store/file.h"
#include "server/store/model_name.h"
#include "server/store/model_repository.h"
#include "server/store/page_token.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;
using google::protobuf::util::TimeUtil;
constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kLook{300};

bool HasEnded(const v1::Batch& batch) { return batch.state() >= v1::Batch::succeeded; }

Answer<void> CheckGlobs(const google::protobuf::RepeatedPtrField<std::string>& globs,
                        const char* name) {
  constexpr int kMost = 100;
  constexpr std::size_t kMostBytes = 4096;
  const auto good = [](const std::string& glob) {
    return !glob.empty() && glob.size() <= kMostBytes && glob.find('\0') == glob.npos;
  };
  if (globs.size() <= kMost && std::all_of(globs.begin(), globs.end(), good)) return {};
  return Refuse(
      Error{ErrorCode::kInvalidArgument,
            std::string(name) + ": expected at most 100 globs of 1 to 4096 bytes without NUL"});
}

/// The bytes of an open file from its beginning, as they are now.
Content ContentOfFile(Fd file, std::uint64_t size, std::string media_type) {
  const auto shared = std::make_shared<const Fd>(std::move(file));
  Content content;
  content.size = size;
  content.media_type = std::move(media_type);
  content.read = [shared](std::uint64_t offset, std::span<char> out) {
    return ReadFileAt(shared->get(), offset, out, "the batch's file");
  };
  return content;
}

std::string MediaTypeOfOutput(const std::string& path) {
  if (const auto format = io::SampleFormatFromPath(path)) return MediaTypeOf(*format);
  return path.ends_with(".json") ? "application/json" : "application/octet-stream";
}

tl::unexpected<Problem> NoSuch(const std::string& what) {
  return Refuse(Error{ErrorCode::kNotFound, what + ": not found"});
}

}  // namespace

// --- What is kept --------------------------------------------------------------------------------

google::protobuf::Timestamp BatchService::Now() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return TimeUtil::MillisecondsToTimestamp(
      std::chrono::duration_cast<std::chrono::milliseconds>(now).count());
}

BatchService::BatchService(const BatchServiceOptions& options, Service& service, Store& store)
    : options_(options),
      service_(service),
      store_(store),
      rows_(store.database().shared()
                ? std::make_unique<BatchRows>(store.database(), store.blobs().membership())
                : nullptr) {}

Result<std::unique_ptr<BatchService>> BatchService::Start(const BatchServiceOptions& options,
                                                          Service& service, Store& store) {
  std::error_code failed;
  fs::create_directories(options.folder, failed);
  if (failed) return Fail(ErrorCode::kIo, options.folder + ": " + failed.message());
  auto batches = std::unique_ptr<BatchService>(new BatchService(options, service, store));
  if (!batches->rows_) {
    if (auto owned = batches->Own(); !owned) return Forward(owned);
  }
  batches->runner_ = std::thread([raw = batches.get()] { raw->RunQueued(); });
  return batches;
}

Result<void> BatchService::Own() {
  const std::string lock = options_.folder + "/lock";
  lock_ = io::Fd(open(lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
  if (!lock_) return Fail(ErrorCode::kIo, lock + ": " + io::SystemReason(errno));
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    return Fail(ErrorCode::kConflict, options_.folder + ": another process runs its batches");
  }
  return Load();
}

BatchService::~BatchService() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  if (runner_.joinable()) runner_.join();
}

Result<void> BatchService::Load() {
  std::error_code failed;
  for (fs::directory_iterator at(options_.folder, failed), end; !failed && at != end;
       at.increment(failed)) {
    const std::string id = at->path().filename().string();
    if (!IsHex(id, 32)) continue;
    std::ifstream file(PathOf(id) + "/batch.json");
    std::ostringstream text;
    if (!file || !(text << file.rdbuf())) continue;  // It was never accepted.
    Entry entry;
    if (auto read = FromJson(text.str(), entry.batch); !read) {
      return Fail(ErrorCode::kCorruptInput, PathOf(id) + "/batch.json: " + read.error().message);
    }
    if (entry.batch.state() == v1::Batch::running) entry.batch.set_state(v1::Batch::queued);
    entries_[id] = std::move(entry);
  }
  return failed ? Result<void>(Fail(ErrorCode::kIo, options_.folder + ": " + failed.message()))
                : Result<void>();
}

Result<void> BatchService::Save(const v1::Batch& batch) {
  if (rows_) return SaveShared(batch);
  auto file = io::AtomicFile::Open(PathOf(batch.id()) + "/batch.json");
  if (!file) return Forward(file);
  if (auto written = (*file)->Write(JsonOf(batch) + '\n'); !written) return written;
  if (auto bytes = (*file)->Finish(); !bytes) return Forward(bytes);
  return {};
}

void BatchService::Change(const std::string& id, const std::function<void(v1::Batch&)>& change) {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return;
  change(found->second.batch);
  ++found->second.revision;
  changed_.notify_all();
}

// --- What clients ask ----------------------------------------------------------------------------

Answer<v1::Batch> BatchService::Create(const v1::CreateBatchRequest& request) {
  if (const auto checked = Canonical(request.options()); !checked) return Refuse(checked.error());
  if (auto good = CheckGlobs(request.include(), "include"); !good) return Pass(good);
  if (auto good = CheckGlobs(request.exclude(), "exclude"); !good) return Pass(good);
  v1::Batch batch;
  batch.set_id(RandomId());
  batch.set_state(v1::Batch::queued);
  *batch.mutable_request() = request;
  *batch.mutable_created() = Now();
  if (rows_) {
    const auto made = rows_->Insert(batch.id(), TimeUtil::TimestampToMilliseconds(batch.created()),
                                    JsonOf(batch), options_.most_queued);
    if (!made && made.error().code == ErrorCode::kOverBudget) {
      return Refuse(Refusal::kUnavailable, made.error().message, 60);
    }
    if (!made) return Refuse(made.error());
    changed_.notify_all();
    return batch;
  }
  const std::lock_guard lock(mutex_);
  const auto waits = [](const auto& each) {
    return each.second.batch.state() == v1::Batch::queued;
  };
  const auto queued = std::count_if(entries_.begin(), entries_.end(), waits);
  if (static_cast<std::uint64_t>(queued) >= options_.most_queued) {
    return Refuse(Refusal::kUnavailable, std::to_string(queued) + " batches wait already", 60);
  }
  if (mkdir(PathOf(batch.id()).c_str(), 0700) != 0) {
    return Refuse(Error{ErrorCode::kIo, "the batch's folder: " + io::SystemReason(errno)});
  }
  if (auto saved = Save(batch); !saved) return Refuse(saved.error());
  entries_[batch.id()].batch = batch;
  changed_.notify_all();
  return batch;
}

Answer<v1::Batch> BatchService::Get(const std::string& id) {
  if (auto refreshed = Refresh(id); !refreshed) return Pass(refreshed);
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return NoSuch("batch");
  return found->second.batch;
}

Answer<v1::ListBatchesResponse> BatchService::List(const v1::ListBatchesRequest& request) {
  const std::size_t size = request.page_size() == 0 ? 100 : request.page_size();
  if (const auto good = CheckPageSize(size); !good) return Refuse(good.error());
  const auto after = ReadPageToken('b', request.page_token());
  if (!after) return Refuse(after.error());
  if (rows_) return ListShared(size, *after);
  // The newest first; of one instant in order of their ids.
  const auto key = [](const v1::Batch& batch) {
    return TimeUtil::ToString(batch.created()) + ' ' + batch.id();
  };
  const std::lock_guard lock(mutex_);
  std::vector<std::pair<std::string, const v1::Batch*>> all;
  for (const auto& [id, entry] : entries_) {
    if (std::string own = key(entry.batch); after->empty() || own < *after) {
      all.emplace_back(std::move(own), &entry.batch);
    }
  }
  std::ranges::sort(all, std::greater<>());
  v1::ListBatchesResponse response;
  for (std::size_t i = 0; i < std::min(size, all.size()); ++i) {
    *response.add_batches() = *all[i].second;
  }
  if (all.size() > size) response.set_next_page_token(MakePageToken('b', all[size - 1].first));
  return response;
}

Answer<v1::Batch> BatchService::Cancel(const std::string& id) {
  if (rows_) {
    const auto row = rows_->Cancel(id, [](const std::string& text, std::int64_t now) {
      v1::Batch cancelled;
      static_cast<void>(FromJson(text, cancelled));
      cancelled.set_state(v1::Batch::cancelled);
      *cancelled.mutable_ended() = TimeUtil::MillisecondsToTimestamp(now);
      return JsonOf(cancelled);
    });
    if (!row) return Refuse(row.error());
    if (!*row) return NoSuch("batch");
    Show(**row);
    return Get(id);
  }
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return NoSuch("batch");
  Entry& entry = found->second;
  if (entry.batch.state() == v1::Batch::queued) {
    v1::Batch cancelled = entry.batch;
    cancelled.set_state(v1::Batch::cancelled);
    *cancelled.mutable_ended() = Now();
    if (auto saved = Save(cancelled); !saved) return Refuse(saved.error());
    entry.batch = std::move(cancelled);
    ++entry.revision;
  }
  entry.cancel = true;
  changed_.notify_all();
  return entry.batch;
}

Answer<void> BatchService::Watch(const std::string& id,
                                 const std::function<bool(const v1::Batch&)>& tell,
                                 const std::function<bool()>& gone) {
  std::uint64_t told = 0;
  auto looked = SteadyClock::now() - kLook;
  while (true) {
    v1::Batch now;
    if (rows_ && SteadyClock::now() - looked >= kLook) {
      // While the database is away it is shown as it was.
      static_cast<void>(Refresh(id));
      looked = SteadyClock::now();
    }
    {
      std::unique_lock lock(mutex_);
      const auto found = entries_.find(id);
      if (found == entries_.end()) return told == 0 ? NoSuch("batch") : Answer<void>();
      if (found->second.revision == told) {
        changed_.wait_for(lock, kTick);
        if (stopping_) return {};
      } else {
        told = found->second.revision;
        now = found->second.batch;
      }
    }
    if (gone() || service_.cancelled()) return {};
    if (now.id().empty()) continue;
    if (!tell(now) || HasEnded(now)) return {};
  }
}

Answer<Content> BatchService::OpenManifest(const std::string& id) {
  const auto batch = Get(id);
  if (!batch) return Pass(batch);
  if (InBucket() && !RunsHere(id)) {
    auto content = OpenObject(id, "manifest.jsonl", "application/x-ndjson");
    if (!content && content.error().code == ErrorCode::kNotFound) {
      return NoSuch("the manifest of a batch that has not begun, or not been saved");
    }
    return content;
  }
  Fd file(open((OutOf(id) + "/manifest.jsonl").c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) return NoSuch("the manifest of a batch that has not begun");
  const auto size = RegularFileSize(file.get(), "manifest");
  if (!size) return Refuse(size.error());
  Content content = ContentOfFile(std::move(file), *size, "application/x-ndjson");
  const auto end = EndOfLines(content.read, *size);
  if (!end) return Refuse(end.error());
  content.size = *end;
  return content;
}

Answer<Content> BatchService::OpenOutput(const std::string& id, const std::string& path) {
  if (const auto batch = Get(id); !batch) return Pass(batch);
  // Hidden names, which are the batch's own, are no names of models; links are not followed.
  if (const auto good = CheckModelName(path); !good) return Refuse(good.error());
  if (path == "manifest.jsonl") return NoSuch("an output of this name");
  if (InBucket()) return OpenObject(id, path, MediaTypeOfOutput(path));
  const auto out = ModelRepository::Open(OutOf(id));
  if (!out) return NoSuch("an output of this name");
  auto file = (*out)->OpenFile(path);
  if (!file && file.error().code == ErrorCode::kNotFound) return NoSuch("an output of this name");
  if (!file) return Refuse(file.error());
  return ContentOfFile(std::move(file->fd), file->size, MediaTypeOfOutput(path));
}

}  // namespace strata::server
