#include "server/batch/batch_service.h"

#include <fcntl.h>
#include <google/protobuf/util/time_util.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <utility>
#include <vector>

#include "io/atomic_file.h"
#include "io/output_place.h"
#include "server/batch/batch_child.h"
#include "server/batch/model_options.h"
#include "server/service/canonical_options.h"
#include "server/service/log.h"
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
constexpr std::chrono::seconds kPatience{5};

google::protobuf::Timestamp Now() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return TimeUtil::MillisecondsToTimestamp(
      std::chrono::duration_cast<std::chrono::milliseconds>(now).count());
}

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

/// The options that decide samples as arguments: those that are there, and no defaults, so that a
/// strata.toml of the repository keeps its say. Precondition: checked.
void AddOptions(const v1::SampleOptions& options, std::vector<std::string>& arguments) {
  const auto fields = nlohmann::json::parse(JsonOf(options));
  for (const auto& [field, value] : fields.items()) {
    std::string name = field;
    std::ranges::replace(name, '_', '-');
    if (!IsModelOption(name)) continue;
    if (value.is_boolean()) {
      if (value.get<bool>()) arguments.push_back("--" + name);
      continue;
    }
    arguments.push_back("--" + name + '=' +
                        (value.is_string() ? value.get<std::string>() : value.dump()));
  }
}

std::string LastLineOf(const std::string& path) {
  std::ifstream file(path);
  std::string last;
  for (std::string line; std::getline(file, line);) {
    if (!line.empty()) last = line;
  }
  constexpr std::string_view kName = "strata: ";
  return last.starts_with(kName) ? last.substr(kName.size()) : last;
}

ErrorCode CodeOf(int status) {
  const auto row = std::ranges::find(kExitCodes, status, &ExitCode::exit_status);
  return row == kExitCodes.end() ? ErrorCode::kInternal : row->code;
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

/// Where the last whole line of a file ends.
std::uint64_t EndOfLines(int fd, std::uint64_t size) {
  std::array<char, 4096> block;
  while (size > 0) {
    const std::size_t n = std::min<std::uint64_t>(size, block.size());
    if (!ReadFileAt(fd, size - n, {block.data(), n}, "manifest")) return 0;
    const std::string_view text(block.data(), n);
    if (const auto at = text.rfind('\n'); at != text.npos) return size - n + at + 1;
    size -= n;
  }
  return 0;
}

tl::unexpected<Problem> NoSuch(const std::string& what) {
  return Refuse(Error{ErrorCode::kNotFound, what + ": not found"});
}

}  // namespace

// --- What is kept --------------------------------------------------------------------------------

Result<std::unique_ptr<BatchService>> BatchService::Start(const BatchServiceOptions& options,
                                                          Service& service) {
  std::error_code failed;
  fs::create_directories(options.folder, failed);
  if (failed) return Fail(ErrorCode::kIo, options.folder + ": " + failed.message());
  auto batches = std::unique_ptr<BatchService>(new BatchService(options, service));
  const std::string lock = options.folder + "/lock";
  batches->lock_ = io::Fd(open(lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
  if (!batches->lock_) return Fail(ErrorCode::kIo, lock + ": " + io::SystemReason(errno));
  if (flock(batches->lock_.get(), LOCK_EX | LOCK_NB) != 0) {
    return Fail(ErrorCode::kConflict, options.folder + ": another process runs its batches");
  }
  if (auto loaded = batches->Load(); !loaded) return Forward(loaded);
  batches->runner_ = std::thread([raw = batches.get()] { raw->RunQueued(); });
  return batches;
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

Result<void> BatchService::Save(const v1::Batch& batch) const {
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

Answer<v1::Batch> BatchService::Get(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return NoSuch("batch");
  return found->second.batch;
}

Answer<v1::ListBatchesResponse> BatchService::List(const v1::ListBatchesRequest& request) const {
  const std::size_t size = request.page_size() == 0 ? 100 : request.page_size();
  if (const auto good = CheckPageSize(size); !good) return Refuse(good.error());
  const auto after = ReadPageToken('b', request.page_token());
  if (!after) return Refuse(after.error());
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
                                 const std::function<bool()>& gone) const {
  std::uint64_t told = 0;
  while (true) {
    v1::Batch now;
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

Answer<Content> BatchService::OpenManifest(const std::string& id) const {
  if (const auto batch = Get(id); !batch) return Pass(batch);
  Fd file(open((PathOf(id) + "/out/manifest.jsonl").c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) return NoSuch("the manifest of a batch that has not begun");
  const auto size = RegularFileSize(file.get(), "manifest");
  if (!size) return Refuse(size.error());
  const std::uint64_t end = EndOfLines(file.get(), *size);
  return ContentOfFile(std::move(file), end, "application/x-ndjson");
}

Answer<Content> BatchService::OpenOutput(const std::string& id, const std::string& path) const {
  if (const auto batch = Get(id); !batch) return Pass(batch);
  // Hidden names, which are the batch's own, are no names of models; links are not followed.
  if (const auto good = CheckModelName(path); !good) return Refuse(good.error());
  if (path == "manifest.jsonl") return NoSuch("an output of this name");
  const auto out = ModelRepository::Open(PathOf(id) + "/out");
  if (!out) return NoSuch("an output of this name");
  auto file = (*out)->OpenFile(path);
  if (!file && file.error().code == ErrorCode::kNotFound) return NoSuch("an output of this name");
  if (!file) return Refuse(file.error());
  return ContentOfFile(std::move(file->fd), file->size, MediaTypeOfOutput(path));
}

// --- Working them off ----------------------------------------------------------------------------

std::string BatchService::NextQueued() const {
  const std::lock_guard lock(mutex_);
  const Entry* next = nullptr;
  for (const auto& [id, entry] : entries_) {
    if (entry.batch.state() != v1::Batch::queued) continue;
    if (!next || entry.batch.created() < next->batch.created()) next = &entry;
  }
  return next ? next->batch.id() : "";
}

bool BatchService::Unwanted(const std::string& id) const {
  const std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  return stopping_ || found == entries_.end() || found->second.cancel;
}

void BatchService::RunQueued() {
  auto cleaned = SteadyClock::now() - kPatience;
  while (true) {
    {
      std::unique_lock lock(mutex_);
      if (stopping_) return;
    }
    if (SteadyClock::now() - cleaned > kPatience) {
      RemoveOld();
      cleaned = SteadyClock::now();
    }
    if (const std::string id = NextQueued(); !id.empty()) {
      Run(id);
    } else {
      std::unique_lock lock(mutex_);
      changed_.wait_for(lock, std::chrono::milliseconds(200));
    }
  }
}

void BatchService::Run(const std::string& id) {
  const auto ticket =
      service_.AdmitBatch(options_.memory_bytes, [this, &id] { return Unwanted(id); });
  v1::Batch batch;
  {
    const std::lock_guard lock(mutex_);
    Entry& entry = entries_[id];
    if (!ticket || stopping_ || entry.batch.state() != v1::Batch::queued) return;
    entry.batch.set_state(v1::Batch::running);
    if (!entry.batch.has_started()) *entry.batch.mutable_started() = Now();
    ++entry.revision;
    batch = entry.batch;
  }
  changed_.notify_all();
  const auto saved = Save(batch);
  Log(LogLevel::kInfo, "batch", {{"id", id}, {"state", std::string("running")}});
  int status = saved ? RunChild(id, batch.request()) : ExitCodeOf(saved.error().code).exit_status;
  // What a killed service left of it may take a moment to end.
  for (int i = 0; i < 20 && status == ExitCodeOf(ErrorCode::kConflict).exit_status; ++i) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, std::chrono::milliseconds(250));
    lock.unlock();
    if (!Unwanted(id)) status = RunChild(id, batch.request());
  }
  End(id, status);
}

int BatchService::RunChild(const std::string& id, const v1::CreateBatchRequest& request) {
  BatchChildPlan plan;
  plan.log = PathOf(id) + "/log";
  plan.arguments = {options_.models,
                    "--output=" + PathOf(id) + "/out",
                    "--quiet",
                    "--jobs=" + std::to_string(options_.jobs),
                    "--memory=" + std::to_string(options_.memory_bytes),
                    "--timeout=" + std::to_string(options_.timeout_seconds)};
  for (const std::string& glob : request.include()) plan.arguments.push_back("--include=" + glob);
  for (const std::string& glob : request.exclude()) plan.arguments.push_back("--exclude=" + glob);
  if (request.all()) plan.arguments.emplace_back("--all");
  AddOptions(request.options(), plan.arguments);
  const auto child = StartBatchChild(plan);
  if (!child) return ExitCodeOf(child.error().code).exit_status;
  int status = 0;
  auto asked = SteadyClock::time_point::max();
  auto looked = SteadyClock::now();
  while (waitpid(*child, &status, WNOHANG) == 0) {
    const auto now = SteadyClock::now();
    if (now - looked > kLook) {
      ReadProgress(id);
      looked = now;
    }
    if (Unwanted(id) && asked == SteadyClock::time_point::max()) {
      kill(*child, SIGTERM);
      asked = now;
    } else if (asked != SteadyClock::time_point::max() && now - asked > kPatience) {
      kill(*child, SIGKILL);
    }
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, kTick);
  }
  ReadProgress(id);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

void BatchService::ReadProgress(const std::string& id) {
  std::ifstream file(PathOf(id) + "/out/.strata/progress.json");
  const auto json = nlohmann::json::parse(file, nullptr, false);
  if (!json.is_object()) return;
  v1::Batch read;
  read.set_models(json.value("models", std::uint64_t{0}));
  read.set_sampled(json.value("sampled", std::uint64_t{0}));
  read.set_unchanged(json.value("unchanged", std::uint64_t{0}));
  read.set_failed_models(json.value("failed", std::uint64_t{0}));
  read.set_samples(json.value("samples", std::uint64_t{0}));
  read.set_seconds_left(json.value("seconds_left", 0.0));
  const auto same = [&read](const v1::Batch& batch) {
    return batch.models() == read.models() && batch.sampled() == read.sampled() &&
           batch.unchanged() == read.unchanged() && batch.failed_models() == read.failed_models();
  };
  if (const auto batch = Get(id); !batch || same(*batch)) return;
  Change(id, [&read](v1::Batch& batch) {
    batch.set_models(read.models());
    batch.set_sampled(read.sampled());
    batch.set_unchanged(read.unchanged());
    batch.set_failed_models(read.failed_models());
    batch.set_samples(read.samples());
    batch.set_seconds_left(read.seconds_left());
  });
}

void BatchService::End(const std::string& id, int status) {
  v1::Batch ended;
  {
    const std::lock_guard lock(mutex_);
    Entry& entry = entries_[id];
    ended = entry.batch;
    if (stopping_ && !entry.cancel && status > 1) {
      ended.set_state(v1::Batch::queued);  // The next process goes on.
    } else {
      ended.set_state(status == 0                   ? v1::Batch::succeeded
                      : entry.cancel && status != 1 ? v1::Batch::cancelled
                                                    : v1::Batch::failed);
      *ended.mutable_ended() = Now();
      ended.set_seconds_left(0);
    }
  }
  if (ended.state() == v1::Batch::failed && status > 1) {
    const Error error = {CodeOf(status), "the batch ended with exit status " +
                                             std::to_string(status) + ": " +
                                             LastLineOf(PathOf(id) + "/log")};
    *ended.mutable_error() = ToMessage(ProblemOf(error), "");
  }
  // A state that is not kept shows after a restart: the batch then finds that nothing is left to
  // do.
  static_cast<void>(Save(ended));
  Change(id, [&ended](v1::Batch& batch) { batch = ended; });
  Log(LogLevel::kInfo, "batch", {{"id", id}, {"state", v1::Batch::State_Name(ended.state())}});
}

void BatchService::RemoveOld() {
  const auto oldest = Now() - TimeUtil::HoursToDuration(options_.retention.count());
  std::vector<std::string> old;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, entry] : entries_) {
      if (HasEnded(entry.batch) && entry.batch.ended() < oldest) old.push_back(id);
    }
    for (const std::string& id : old) entries_.erase(id);
  }
  for (const std::string& id : old) {
    std::error_code ignored;
    fs::remove(PathOf(id) + "/batch.json", ignored);  // First: what is left is then no batch.
    fs::remove_all(PathOf(id), ignored);
  }
}

}  // namespace strata::server
