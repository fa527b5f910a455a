#include "server/batch/run_batch.h"

#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <thread>
#include <utility>

#include "core/stopwatch.h"
#include "io/output_place.h"
#include "server/batch/batch_lane.h"
#include "server/batch/batch_plan.h"
#include "server/batch/former_lines.h"
#include "server/batch/open_places.h"
#include "server/batch/owner.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kTick{100};
constexpr std::chrono::seconds kSaveStateEvery{30};

std::string ManifestName(const ModelShare& share) {
  return "manifest" + ShareSuffix(share) + ".jsonl";
}

std::string ProgressPath(const std::string& state, const ModelShare& share) {
  return state + "/.strata/progress" + ShareSuffix(share) + ".json";
}

Result<void> MakeFolder(const std::string& path) {
  if (mkdir(path.c_str(), 0777) == 0 || errno == EEXIST) return {};
  return Fail(ErrorCode::kIo, path + ": " + io::SystemReason(errno));
}

/// Says in a file how far a batch is: for the service, and whoever looks. Not durable, and no
/// failure of the batch where it cannot be written.
class ProgressFile {
 public:
  ProgressFile(const BatchProgress& progress, std::string path)
      : progress_(progress), path_(std::move(path)) {}

  void Write() {
    const std::string next = path_ + ".next";
    std::ofstream file(next, std::ios::binary);
    file << progress_.Json();
    file.close();
    if (file) static_cast<void>(std::rename(next.c_str(), path_.c_str()));
  }
  void WriteNowAndThen() {
    if (watch_.seconds() < 0.5) return;
    watch_ = {};
    Write();
  }

 private:
  const BatchProgress& progress_;
  const std::string path_;
  Stopwatch watch_;
};

/// One run of a batch, from its lanes' start to their end.
class Batch {
 public:
  Batch(BatchShop shop, Manifest& manifest, const FormerLines& former, BatchPlan& plan,
        BatchProgress& progress)
      : shop_(std::move(shop)),
        manifest_(manifest),
        former_(former),
        progress_(progress),
        file_(progress, ProgressPath(shop_.state, shop_.command.share)),
        schedule_(std::exchange(plan.tasks, {})) {
    shop_.gone = [this] { return ended_.load(); };
    file_.Write();
  }

  /// Errors: kCancelled, kIo of the manifest.
  Result<void> Run(RunContext& context) {
    std::vector<std::thread> lanes;
    living_ = shop_.memory.lanes;
    for (std::uint32_t i = 0; i < shop_.memory.lanes; ++i) lanes.emplace_back([this] { Work(); });
    std::thread saver([this] { SaveNowAndThen(); });
    {
      std::unique_lock lock(mutex_);
      while (!changed_.wait_for(lock, kTick, [this] { return living_ == 0; })) {
        if (context.cancelled()) End();
        progress_.Tick();
        file_.WriteNowAndThen();
      }
      done_ = true;
    }
    changed_.notify_all();
    for (std::thread& lane : lanes) lane.join();
    saver.join();
    file_.Write();
    if (context.cancelled()) return Cancelled();
    return outcome_;
  }

 private:
  void End() {
    ended_ = true;
    schedule_.Stop();
  }

  void Work() {
    {
      BatchLane lane(shop_);
      while (const auto task = schedule_.Take()) {
        const TaskOutcome outcome = lane.Run(*task);
        if (auto noted = Note(*task, outcome); !noted) Abort(noted.error());
      }
    }
    const std::lock_guard lock(mutex_);
    --living_;
    changed_.notify_all();
  }

  /// Without a manifest nothing that is done would be known.
  void Abort(const Error& error) {
    const std::lock_guard lock(mutex_);
    if (outcome_) outcome_ = tl::unexpected<Error>(error);
    End();
  }

  Result<void> Note(const BatchTask& task, const TaskOutcome& outcome) {
    const ManifestLine& line = outcome.line;
    if (outcome.kind == TaskOutcome::Kind::kGone) {
      schedule_.End(task);
      return {};
    }
    if (outcome.kind == TaskOutcome::Kind::kFailed && outcome.not_its_fault && task.attempt == 1) {
      progress_.AddRetry(line.path, line.error_message);
      schedule_.Retry(task);
      return {};
    }
    const bool unchanged = outcome.kind == TaskOutcome::Kind::kUnchanged;
    auto noted = unchanged ? KeepLine(task) : Write(line);
    schedule_.End(task);
    if (!noted) return Forward(noted);
    Count(task, *noted, unchanged);
    return {};
  }

  /// What a former batch made of the same bytes counts on, a failure too.
  void Count(const BatchTask& task, const ManifestLine& line, bool unchanged) {
    using End = BatchProgress::End;
    if (line.sampled) {
      const std::uint64_t samples = unchanged ? 0 : line.samples;
      progress_.Add(unchanged ? End::kSkipped : End::kSampled, task.cost, samples, line.path);
    } else {
      progress_.Add(unchanged ? End::kFailedBefore : End::kFailed, task.cost, 0, line.path,
                    line.error_type, line.error_message);
    }
  }

  /// The line of a model whose bytes have not changed, with what tells that the next time without
  /// reading them.
  Result<ManifestLine> KeepLine(const BatchTask& task) {
    auto former = manifest_.Find(task.model->path);
    if (!former) return Forward(former);
    if (!*former) return Fail(ErrorCode::kInternal, task.model->path + ": its line is gone");
    ManifestLine line = **std::move(former);
    line.stamp = task.model->stamp;
    line.input_bytes = task.model->size;
    if (auto appended = manifest_.Append(line); !appended) return Forward(appended);
    return line;
  }

  /// The line, and what former lines of this model named and this one does not: no output stands
  /// there that is not the one of these bytes and options.
  Result<ManifestLine> Write(const ManifestLine& line) {
    const auto former = former_.Of(line.path);
    if (!former) return Forward(former);
    for (const ManifestLine& each : *former) {
      if (!each.sampled || each.output == line.output) continue;
      if (auto removed = shop_.outputs.Remove(each.output); !removed) return Forward(removed);
    }
    if (auto appended = manifest_.Append(line); !appended) return Forward(appended);
    return line;
  }

  void SaveNowAndThen() {
    std::unique_lock lock(mutex_);
    while (!changed_.wait_for(lock, kSaveStateEvery, [this] { return done_; })) {
      lock.unlock();
      auto saved = shop_.outputs.SaveState(false);
      lock.lock();
      if (saved || !outcome_) continue;
      outcome_ = Forward(saved);
      End();
    }
  }

  BatchShop shop_;
  Manifest& manifest_;
  const FormerLines& former_;
  BatchProgress& progress_;
  ProgressFile file_;
  Schedule schedule_;
  std::atomic<bool> ended_{false};
  std::mutex mutex_;
  std::condition_variable changed_;
  std::uint32_t living_ = 0;
  bool done_ = false;
  Result<void> outcome_;
};

/// What a batch works with.
struct Parts {
  const BatchCommand& command;
  Places& places;
  const std::string& state;
  Manifest& manifest;
  const FormerLines& former;
};

/// The outputs and pictures of one model: as many as were there. What has another size than a line
/// says is none that it speaks of.
Result<std::uint64_t> RemoveOutputs(const Parts& batch, const std::string& path) {
  const auto lines = batch.former.Of(path);
  if (!lines) return Forward(lines);
  std::uint64_t removed = 0;
  for (const ManifestLine& line : *lines) {
    std::error_code ignored;
    if (!line.picture.empty()) std::filesystem::remove(batch.state + '/' + line.picture, ignored);
    if (!line.sampled) continue;
    const auto there = batch.places.outputs->IsThere(line.output, line.output_bytes);
    if (!there) return Forward(there);
    if (!*there) continue;
    if (auto done = batch.places.outputs->Remove(line.output); !done) return Forward(done);
    ++removed;
  }
  return removed;
}

/// The paths of models that are gone. One of which that cannot be told is kept.
std::vector<std::string> GoneModels(const Parts& batch, std::span<const ModelEntry> listed) {
  std::vector<std::string> gone;
  for (std::string& path : batch.former.Paths()) {
    if (!InShare(path, batch.command.share)) continue;
    // Also what is listed only to fail is there.
    if (std::ranges::binary_search(listed, path, {}, &ModelEntry::path)) continue;
    const auto model = batch.places.models->Find(path);
    if (model && !*model) gone.push_back(std::move(path));
  }
  return gone;
}

/// How many models of this share have been heard of.
std::size_t CountOfShare(const Parts& batch) {
  const auto paths = batch.former.Paths();
  return static_cast<std::size_t>(std::ranges::count_if(
      paths, [&](const std::string& path) { return InShare(path, batch.command.share); }));
}

/// Removes the outputs of models that are gone; `listed` are those that are there, in order of
/// their paths. Returns how many.
Result<std::uint64_t> Prune(const Parts& batch, std::span<const ModelEntry> listed) {
  const std::vector<std::string> gone = GoneModels(batch, listed);
  if (listed.empty() && !gone.empty() && gone.size() == CountOfShare(batch)) {
    return Fail(ErrorCode::kNotFound,
                batch.command.repository + ": holds none of the " + std::to_string(gone.size()) +
                    " models that were sampled; is it the right place, and mounted? --prune "
                    "removes nothing");
  }
  std::uint64_t pruned = 0;
  for (const std::string& path : gone) {
    const auto removed = RemoveOutputs(batch, path);
    if (!removed) return Forward(removed);
    pruned += *removed;
    if (!batch.former.IsElsewhere(path)) {
      batch.manifest.Forget(path);
      continue;
    }
    // The other manifest, which is another share's to write, keeps its line: this one takes its
    // place.
    ManifestLine line;
    line.path = path;
    line.gone = true;
    line.measured.finished = InstantNow();
    if (auto appended = batch.manifest.Append(line); !appended) return Forward(appended);
  }
  return pruned;
}

Result<void> Sample(const Parts& batch, BatchPlan& plan, BatchProgress& progress,
                    RunContext& context) {
  const auto& [command, places, state, manifest, former] = batch;
  auto planned = PlanBatch(command, {*places.models, *places.outputs, manifest, former});
  if (!planned) return Forward(planned);
  plan = *std::move(planned);
  progress.Begin(plan.tally, plan.cost);
  std::vector<const ModelEntry*> order;
  for (const bool whole : {true, false}) {
    for (const BatchTask& task : plan.tasks) {
      if (task.whole_machine == whole) order.push_back(task.model);
    }
  }
  if (order.empty()) {
    ProgressFile(progress, ProgressPath(state, command.share)).Write();
    return {};
  }
  places.models->Announce(order);
  if (auto made = MakeFolder(state + "/.strata/pictures"); !made) return made;
  const MemoryParts memory = DivideMemory(command.memory_bytes, command.jobs, order.size());
  BatchShop shop = {command, *places.models, *places.outputs, state, memory, 1, {}};
  // Fewer models than processors share them.
  shop.small_threads = std::max<std::uint32_t>(
      1,
      command.jobs / static_cast<std::uint32_t>(std::min<std::size_t>(order.size(), command.jobs)));
  return Batch(std::move(shop), manifest, former, plan, progress).Run(context);
}

}  // namespace

Result<BatchTally> RunBatch(const BatchCommand& command, RunContext& context) {
  auto places = OpenPlaces(command);
  if (!places) return Forward(places);
  const auto state = places->outputs->OpenState();
  if (!state) return Forward(state);
  const std::string suffix = ShareSuffix(command.share);
  auto owner = Owner::Take(*state, suffix.empty() ? suffix : suffix.substr(1));
  if (!owner) return Forward(owner);
  if (owner->former_was_killed()) places->outputs->DiscardAll();
  auto manifest = Manifest::Open(*state + '/' + ManifestName(command.share));
  if (!manifest) return Forward(manifest);
  BatchProgress progress(command.quiet, std::chrono::seconds(command.progress_seconds));
  const auto former = FormerLines::Open(*state, ManifestName(command.share), **manifest);
  if (!former) return Forward(former);
  const Parts batch = {command, *places, *state, **manifest, *former};
  BatchPlan plan;
  auto sampled = Sample(batch, plan, progress, context);
  progress.Stop();
  if (!sampled) {
    // What was finished is kept where it belongs, too.
    static_cast<void>(places->outputs->SaveState(true));
    return Forward(sampled);
  }
  if (command.prune) {
    const auto pruned = Prune(batch, plan.models);
    if (!pruned) return Forward(pruned);
    progress.SetPruned(*pruned);
  }
  if (auto written = (*manifest)->Rewrite(); !written) return Forward(written);
  if (auto saved = places->outputs->SaveState(true); !saved) return Forward(saved);
  owner->Finish();
  if (!command.quiet) {
    std::fputs(BatchSummary(progress.tally(), progress.seconds()).c_str(), stderr);
  }
  return progress.tally();
}

}  // namespace strata::server
