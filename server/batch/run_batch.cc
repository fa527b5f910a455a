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
#include <thread>
#include <utility>

#include "core/stopwatch.h"
#include "io/output_place.h"
#include "server/batch/batch_lane.h"
#include "server/batch/batch_plan.h"
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

/// The manifests of other shares in the same folder, or of a batch of another number of shares.
Result<std::vector<ManifestReader>> OtherManifests(const std::string& state,
                                                   const std::string& own) {
  std::vector<ManifestReader> others;
  std::error_code failed;
  for (std::filesystem::directory_iterator at(state, failed), end; !failed && at != end;
       at.increment(failed)) {
    const std::string name = at->path().filename().string();
    if (name == own || !name.starts_with("manifest") || !name.ends_with(".jsonl")) continue;
    auto reader = ManifestReader::Open(at->path().string());
    if (!reader) return Forward(reader);
    others.push_back(*std::move(reader));
  }
  return others;
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
  Batch(BatchShop shop, Manifest& manifest, BatchPlan& plan, BatchProgress& progress)
      : shop_(std::move(shop)),
        manifest_(manifest),
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
    auto noted = Write(task, outcome);
    schedule_.End(task);
    if (!noted) return noted;
    if (outcome.kind == TaskOutcome::Kind::kUnchanged) {
      progress_.Add(BatchProgress::End::kSkipped, task.cost, 0, line.path);
    } else if (outcome.kind == TaskOutcome::Kind::kSampled) {
      progress_.Add(BatchProgress::End::kSampled, task.cost, line.samples, line.path);
    } else {
      progress_.Add(BatchProgress::End::kFailed, task.cost, 0, line.path, line.error_type,
                    line.error_message);
    }
    return {};
  }

  /// The line, and what a former line of this model named and this one does not: no output stands
  /// there that is not the one of these bytes and options.
  Result<void> Write(const BatchTask& task, const TaskOutcome& outcome) {
    const auto former = manifest_.Find(task.model->path);
    if (!former) return Forward(former);
    if (outcome.kind == TaskOutcome::Kind::kUnchanged) {
      if (!*former) return {};
      ManifestLine line = **former;
      line.stamp = task.model->stamp;
      line.input_bytes = task.model->size;
      return manifest_.Append(line);
    }
    const bool outdated = *former && (*former)->sampled && (*former)->output != outcome.line.output;
    if (outdated) {
      if (auto removed = shop_.outputs.Remove((*former)->output); !removed) return removed;
    }
    return manifest_.Append(outcome.line);
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

/// Removes the outputs of models that are gone. Returns how many.
Result<std::uint64_t> Prune(const ModelShare& share, ModelSource& source, OutputPlace& outputs,
                            Manifest& manifest, const std::string& state) {
  std::uint64_t pruned = 0;
  for (const std::string& path : manifest.Paths()) {
    if (!InShare(path, share)) continue;
    const auto model = source.Find(path);
    if (!model) return Forward(model);
    if (*model) continue;
    const auto line = manifest.Find(path);
    if (!line) return Forward(line);
    if ((*line)->sampled) {
      if (auto removed = outputs.Remove((*line)->output); !removed) return Forward(removed);
      ++pruned;
    }
    if (!(*line)->picture.empty()) {
      std::error_code ignored;
      std::filesystem::remove(state + '/' + (*line)->picture, ignored);
    }
    manifest.Forget(path);
  }
  return pruned;
}

Result<void> Sample(const BatchCommand& command, Places& places, const std::string& state,
                    Manifest& manifest, BatchProgress& progress, RunContext& context) {
  const auto others = OtherManifests(state, ManifestName(command.share));
  if (!others) return Forward(others);
  auto plan = PlanBatch(command, *places.models, *places.outputs, manifest, *others);
  if (!plan) return Forward(plan);
  progress.Begin(plan->tally, plan->cost);
  std::vector<const ModelEntry*> order;
  for (const bool whole : {true, false}) {
    for (const BatchTask& task : plan->tasks) {
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
  return Batch(std::move(shop), manifest, *plan, progress).Run(context);
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
  auto sampled = Sample(command, *places, *state, **manifest, progress, context);
  progress.Stop();
  if (!sampled) {
    // What was finished is kept where it belongs, too.
    static_cast<void>(places->outputs->SaveState(true));
    return Forward(sampled);
  }
  if (command.prune) {
    const auto pruned = Prune(command.share, *places->models, *places->outputs, **manifest, *state);
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
