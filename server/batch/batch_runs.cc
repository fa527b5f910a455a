// BatchService: working the batches off.
#include <google/protobuf/util/time_util.h>
#include <signal.h>
#include <sys/wait.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "server/batch/batch_child.h"
#include "server/batch/batch_service.h"
#include "server/batch/model_options.h"
#include "server/service/canonical_options.h"
#include "server/service/log.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;
using google::protobuf::util::TimeUtil;
constexpr std::chrono::milliseconds kTick{50};
constexpr std::chrono::milliseconds kLook{300};
constexpr std::chrono::seconds kPatience{5};

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

}  // namespace

std::string BatchService::NextQueued() {
  if (rows_) return Claim();
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
  return stopping_ || found == entries_.end() || found->second.cancel || found->second.lost;
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
      // Others' come without a word.
      changed_.wait_for(lock, std::chrono::milliseconds(rows_ ? 1000 : 200));
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
    if (!entry.claimed && (!ticket || stopping_ || entry.batch.state() != v1::Batch::queued)) {
      return;
    }
    entry.batch.set_state(v1::Batch::running);
    if (!entry.batch.has_started()) *entry.batch.mutable_started() = Now();
    ++entry.revision;
    batch = entry.batch;
  }
  changed_.notify_all();
  auto saved = Save(batch);
  std::error_code failed;
  fs::create_directories(PathOf(id), failed);
  if (failed) saved = Fail(ErrorCode::kIo, "the batch's folder: " + failed.message());
  Log(LogLevel::kInfo, "batch", {{"id", id}, {"state", std::string("running")}});
  if (!ticket) {  // Cancelled, lost or given back before its turn.
    return End(id, ExitCodeOf(ErrorCode::kCancelled).exit_status);
  }
  const bool goes_on = saved || (rows_ && IsDatabaseAway(saved.error()));
  int status = goes_on ? RunChild(id, batch.request()) : ExitCodeOf(saved.error().code).exit_status;
  // What a killed service left of it may take a moment to end; a paused one's, longer.
  const int tries = rows_ ? 2400 : 20;
  for (int i = 0; i < tries && status == ExitCodeOf(ErrorCode::kConflict).exit_status; ++i) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, std::chrono::milliseconds(250));
    lock.unlock();
    if (rows_) static_cast<void>(Refresh(id));
    if (Unwanted(id)) break;
    status = RunChild(id, batch.request());
  }
  End(id, status);
}

int BatchService::RunChild(const std::string& id, const v1::CreateBatchRequest& request) {
  BatchChildPlan plan;
  plan.log = PathOf(id) + "/log";
  plan.arguments = {options_.models,
                    "--output=" + (InBucket() ? options_.bucket + '/' + id : OutOf(id)),
                    "--quiet",
                    "--jobs=" + std::to_string(options_.jobs),
                    "--memory=" + std::to_string(options_.memory_bytes),
                    "--timeout=" + std::to_string(options_.timeout_seconds)};
  for (const std::string& glob : request.include()) plan.arguments.push_back("--include=" + glob);
  for (const std::string& glob : request.exclude()) plan.arguments.push_back("--exclude=" + glob);
  if (request.all()) plan.arguments.emplace_back("--all");
  if (InBucket()) {
    plan.arguments.push_back("--state=" + OutOf(id));
    if (options_.s3_insecure) plan.arguments.emplace_back("--s3-insecure");
    plan.environment = options_.bucket_environment;
  }
  AddOptions(request.options(), plan.arguments);
  const auto child = StartBatchChild(plan);
  if (!child) return ExitCodeOf(child.error().code).exit_status;
  int status = 0;
  auto asked = SteadyClock::time_point::max();
  auto looked = SteadyClock::now(), heard = looked;
  while (waitpid(*child, &status, WNOHANG) == 0) {
    const auto now = SteadyClock::now();
    if (now - looked > kLook) {
      // Cancelled elsewhere, or another's by now; which it is, too, once nobody has heard of it.
      if (Refresh(id)) heard = now;
      if (rows_ && now - heard > options_.lease) Lose(id);
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
  std::ifstream file(OutOf(id) + "/.strata/progress.json");
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
  {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(id);
    if (found == entries_.end() || same(found->second.batch)) return;
  }
  Change(id, [&read](v1::Batch& batch) {
    batch.set_models(read.models());
    batch.set_sampled(read.sampled());
    batch.set_unchanged(read.unchanged());
    batch.set_failed_models(read.failed_models());
    batch.set_samples(read.samples());
    batch.set_seconds_left(read.seconds_left());
  });
  if (!rows_) return;
  v1::Batch now;
  {
    const std::lock_guard lock(mutex_);
    now = entries_[id].batch;
  }
  static_cast<void>(SaveShared(now));  // The next look says more.
}

void BatchService::End(const std::string& id, int status) {
  if (GiveUpLost(id)) return;
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
  Close(ended);
}

// A state that is not kept shows after a restart, or at another process: the batch then finds that
// nothing is left to do.
void BatchService::Close(const v1::Batch& ended) {
  while (true) {
    const auto saved = Save(ended);
    if (saved || !IsDatabaseAway(saved.error())) break;
    std::unique_lock lock(mutex_);
    if (stopping_) break;
    changed_.wait_for(lock, kPatience / 5);
  }
  if (GiveUpLost(ended.id())) return;
  Change(ended.id(), [&ended](v1::Batch& batch) { batch = ended; });
  Log(LogLevel::kInfo, "batch",
      {{"id", ended.id()}, {"state", v1::Batch::State_Name(ended.state())}});
}

void BatchService::RemoveOld() {
  if (rows_) return RemoveOldShared();
  const auto oldest = Now() - TimeUtil::HoursToDuration(options_.retention.count());
  std::vector<std::string> old;
  {
    const std::lock_guard lock(mutex_);
    for (const auto& [id, entry] : entries_) {
      if (entry.batch.state() >= v1::Batch::succeeded && entry.batch.ended() < oldest)
        old.push_back(id);
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
