#include "server/sample_command.h"

#include <sys/resource.h>
#include <sys/stat.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <thread>
#include <tuple>
#include <utility>
#include <vector>

#include "core/partial.h"
#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "core/stopwatch.h"
#include "io/atomic_file.h"
#include "io/file_digest.h"
#include "io/job_folder.h"
#include "io/open_mesh.h"
#include "io/picture.h"
#include "io/sample_writer.h"
#include "server/progress_bar.h"
#include "server/region_merge.h"
#include "server/resources.h"
#include "server/summary_json.h"
#include "server/write_samples.h"

namespace strata::server {
namespace {

// --- Before the work: can the places be what they are named to be? -------------------------------

struct Place {
  const char* role;
  std::string path;
};

std::vector<Place> PlacesOf(const SampleCommand& command) {
  std::vector<Place> places = {{"INPUT", command.input}, {"OUTPUT", command.output}};
  if (command.picture) places.push_back({"--picture", *command.picture});
  if (command.summary) places.push_back({"--summary", *command.summary});
  std::erase_if(places, [](const Place& place) { return place.path == "-"; });
  return places;
}

std::optional<struct stat> StatusOf(const std::string& path) {
  struct stat status {};
  if (stat(path.c_str(), &status) != 0) return std::nullopt;
  return status;
}

/// The path without links, "." and "..", as far as it exists.
std::filesystem::path Resolved(const std::string& path) {
  std::error_code failed;
  auto resolved =
      std::filesystem::weakly_canonical(std::filesystem::absolute(path, failed), failed);
  return failed ? std::filesystem::path(path) : resolved;
}

/// Devices and pipes may be named twice: nothing is replaced there.
bool SameFile(const std::string& a, const std::string& b) {
  const auto left = StatusOf(a), right = StatusOf(b);
  if (!left || !right) return !left && !right && Resolved(a) == Resolved(b);
  return S_ISREG(left->st_mode) &&
         std::tie(left->st_dev, left->st_ino) == std::tie(right->st_dev, right->st_ino);
}

Result<void> RefuseSameFiles(const std::vector<Place>& places) {
  for (std::size_t i = 0; i < places.size(); ++i) {
    for (std::size_t j = i + 1; j < places.size(); ++j) {
      const bool both_read = std::string_view(places[i].role) == places[j].role;
      if (both_read || !SameFile(places[i].path, places[j].path)) continue;
      return Fail(ErrorCode::kInvalidArgument, std::string(places[i].role) + " and " +
                                                   places[j].role +
                                                   " are the same file: " + places[j].path);
    }
  }
  return {};
}

/// Opens each output as the job will, and lets go of it again. Devices and pipes are left alone:
/// opening a FIFO would already be a message to its reader.
Result<void> CheckWritable(const std::vector<Place>& places, io::SampleFormat format) {
  for (const Place& place : places) {
    const auto status = StatusOf(place.path);
    const bool is_folder = status && S_ISDIR(status->st_mode);
    if (place.role == std::string("INPUT")) continue;
    if (status && !S_ISREG(status->st_mode) && !is_folder) continue;
    const bool tiles = format == io::SampleFormat::kDraco && place.role == std::string("OUTPUT");
    if (const auto file = io::AtomicFile::Open(place.path, tiles ? io::kTilesetName : ""); !file) {
      return Forward(file);
    }
  }
  return {};
}

Result<void> ChooseVectorTarget(const std::string& name) {
  if (name == "auto") return {};
  return ForceSimdTarget(name);
}

// --- The work ------------------------------------------------------------------------------------

/// What the method finds wrong with a surface does not name the file, which it does not know.
Error Named(Error error, const std::string& input) {
  const std::string name = input == "-" ? "standard input" : input;
  const bool of_input = error.code == ErrorCode::kEmptySurface ||
                        error.code == ErrorCode::kOverBudget ||
                        error.code == ErrorCode::kCorruptInput;
  if (of_input && !error.message.starts_with(name)) error.message = name + ": " + error.message;
  return error;
}

Result<std::unique_ptr<MeshReader>> OpenInput(const SampleCommand& command, RunContext& context,
                                              JobFigures& figures) {
  const Stopwatch watch;
  io::OpenOptions open = OpenWithin(context, command.assimp);
  open.companions = command.companions;
  auto reader = io::OpenMesh(command.input, open);
  if (!reader) return Forward(reader);
  if (context.cancelled()) return Cancelled();
  figures.mesh = (*reader)->info();
  figures.open_bytes = (*reader)->bytes_read();
  figures.open_seconds = watch.seconds();
  return reader;
}

Result<SampledMesh> Sample(const SampleCommand& command, MeshReader& reader, RunContext& context,
                           JobFigures& figures) {
  auto result = SampleMeshStreamed(reader, OptionsForOutput(command), context);
  figures.scan_bytes = reader.bytes_read() - figures.open_bytes;
  if (!result) return tl::unexpected<Error>(Named(result.error(), command.input));
  return result;
}

/// The samples that a picture shows: all, or evenly many of more than it can show.
class PictureSamples {
 public:
  PictureSamples(bool wanted, std::uint64_t count)
      : step_(wanted ? (count + kMost - 1) / kMost : 0) {}
  void Add(const SampleColumns& samples) {
    for (std::size_t i = 0; step_ > 0 && i < samples.size(); ++i) {
      if (seen_++ % step_ != 0) continue;
      shown_.position.push_back(samples.position[i]);
      if (!samples.normal.empty()) shown_.normal.push_back(samples.normal[i]);
    }
  }
  const SampleColumns& shown() const { return shown_; }

 private:
  static constexpr std::uint64_t kMost = 4'000'000;
  std::uint64_t step_, seen_ = 0;
  SampleColumns shown_;
};

Result<void> WriteSamples(const SampleCommand& command, SampledMesh& sampled,
                          PictureSamples& picture, RunContext& context, JobFigures& figures) {
  const Stopwatch watch;
  context.SetStage(RunContext::Stage::kWrite);
  auto writer = io::OpenSampleWriter(command.output, command.format, HeaderOf(command, sampled),
                                     ResourcesOf(command, context));
  if (!writer) return Forward(writer);
  const auto bytes = WriteAll(sampled, **writer, context,
                              [&](const SampleColumns& samples) { picture.Add(samples); });
  if (!bytes) return Forward(bytes);
  figures.write_bytes = *bytes;
  figures.write_seconds = watch.seconds();
  return {};
}

Result<void> DrawPicture(const SampleCommand& command, const SampleColumns& samples, double edge,
                         RunContext& context, JobFigures& figures) {
  if (!command.picture) return {};
  if (context.cancelled()) return Cancelled();
  const Stopwatch watch;
  auto drawn = io::WritePicture(
      *command.picture, samples,
      {.edge = edge, .width = command.picture_width, .height = command.picture_height});
  figures.picture_seconds = watch.seconds();
  return drawn;
}

Result<void> WriteSummary(const SampleCommand& command, const SampleStats& stats,
                          const JobFigures& figures) {
  if (!command.summary) return {};
  auto file = io::AtomicFile::Open(*command.summary);
  if (!file) return Forward(file);
  if (auto written = (*file)->Write(SummaryJson(command, stats, figures)); !written) return written;
  if (auto bytes = (*file)->Finish(); !bytes) return Forward(bytes);
  return {};
}

int ThreadsOf(const SampleOptions& options) {
  return options.threads > 0 ? options.threads
                             : static_cast<int>(std::thread::hardware_concurrency());
}

/// A job of any command: what it needs before its work, and what it does with its samples.
class Job {
 public:
  Job(const SampleCommand& command, RunContext& context)
      : command_(command), context_(context), bar_(context, !command.quiet) {
    figures.threads = ThreadsOf(command.options);
  }
  Job(const Job&) = delete;
  Job& operator=(const Job&) = delete;
  ~Job() {
    context_.SetScratch(nullptr);
    context_.SetCheckpoints(nullptr);
  }

  Result<void> Prepare(const std::vector<Place>& places) {
    if (auto checked = RefuseSameFiles(places); !checked) return checked;
    if (auto checked = CheckWritable(places, command_.format); !checked) return checked;
    if (command_.format == io::SampleFormat::kVdb) {
      if (auto found = io::CheckVdbProgram(VdbProgram()); !found) return found;
    }
    if (auto chosen = ChooseVectorTarget(command_.simd); !chosen) return chosen;
    auto scratch = OpenScratch(command_.scratch);
    if (!scratch) return Forward(scratch);
    scratch_ = std::move(*scratch);
    context_.SetScratch(scratch_.get());
    if (scratch_ && !command_.resume) io::RemoveAbandonedJobs(scratch_->path());
    return {};
  }

  /// What the scan comes to then outlives a process that is killed. Standard input does not.
  Result<void> KeepCheckpoints(const Share& share, const std::optional<Lattice>& lattice) {
    if (!command_.checkpoint_folder.empty()) {
      return KeepIn(command_.checkpoint_folder, command_.checkpoint_key, true);
    }
    if (!scratch_ || command_.input == "-" || !command_.checkpoints) return {};
    const auto key = JobKey(command_, share, lattice);
    if (!key) return Forward(key);
    return KeepIn(scratch_->path(), *key, command_.resume);
  }

  Result<void> KeepIn(const std::string& directory, const std::string& key, bool go_on) {
    auto folder = io::JobFolder::Open(directory, key, go_on);
    if (!folder) return Forward(folder);
    folder_ = std::move(*folder);
    context_.SetCheckpoints(folder_.get());
    return {};
  }

  Result<void> Deliver(SampledMesh sampled, JobReport* report = nullptr) {
    const SampleStats& stats = sampled.stats;
    figures.carried = sampled.carried;
    PictureSamples picture(command_.picture.has_value(), stats.survivors);
    auto written = WriteSamples(command_, sampled, picture, context_, figures);
    if (!written) return written;
    auto drawn = DrawPicture(command_, picture.shown(), stats.lattice.edge, context_, figures);
    if (!drawn) return drawn;
    figures.total_seconds = watch_.seconds();
    bar_.Stop();
    if (auto noted = WriteSummary(command_, stats, figures); !noted) return noted;
    if (folder_) folder_->Finish();
    if (!command_.quiet) std::fputs(SummaryText(command_, stats, figures).c_str(), stderr);
    if (report) *report = {stats, figures};
    return {};
  }

  Result<void> DeliverRegion(const RegionJob& region, ScannedMesh scanned) {
    const auto report = MergeRegion(region, std::move(scanned), context_);
    if (!report) return Forward(report);
    bar_.Stop();
    if (!command_.quiet) std::fputs(RegionText(region, *report).c_str(), stderr);
    return {};
  }

  Result<void> WritePartialFile(const PartialInfo& info, ReservoirStore& store) {
    context_.SetStage(RunContext::Stage::kWrite);
    auto file = io::AtomicFile::Open(command_.output);
    if (!file) return Forward(file);
    auto written = WritePartial([&](std::string_view bytes) { return (*file)->Write(bytes); }, info,
                                store, context_);
    if (!written) return written;
    const auto bytes = (*file)->Finish();
    if (!bytes) return Forward(bytes);
    if (folder_) folder_->Finish();
    bar_.Stop();
    if (!command_.quiet) std::fputs(PartialText(command_.output, info, *bytes).c_str(), stderr);
    return {};
  }

  JobFigures figures;

 private:
  const SampleCommand& command_;
  RunContext& context_;
  Stopwatch watch_;
  std::unique_ptr<ScratchFolder> scratch_;
  std::unique_ptr<io::JobFolder> folder_;
  ProgressBar bar_;
};

std::vector<Place> PlacesOf(const MergeCommand& command) {
  std::vector<Place> places = PlacesOf(command.job);
  for (const std::string& input : command.inputs) places.push_back({"INPUT", input});
  return places;
}

/// Lets the process open as many files as the system lets it: a merge holds all its parts open.
void RaiseOpenFiles() {
  rlimit files{};
  if (getrlimit(RLIMIT_NOFILE, &files) != 0 || files.rlim_cur == files.rlim_max) return;
  files.rlim_cur = files.rlim_max;
  static_cast<void>(setrlimit(RLIMIT_NOFILE, &files));
}

Result<CombinedPartials> Combine(const MergeCommand& command, RunContext& context) {
  RaiseOpenFiles();
  std::vector<Partial> partials;
  for (const std::string& input : command.inputs) {
    auto file = OpenForReading(input);
    if (!file) return Forward(file);
    auto partial = OpenPartial(std::move(*file));
    if (!partial) return Forward(partial);
    partials.push_back(std::move(*partial));
  }
  return CombinePartials(std::move(partials), context);
}

}  // namespace

Result<void> RunScan(const ScanCommand& command, RunContext& context) {
  const SampleCommand& command_of_job = command.job;
  Job job(command_of_job, context);
  if (auto ready = job.Prepare(PlacesOf(command_of_job)); !ready) return ready;
  const auto mesh = io::FileDigest(command_of_job.input);
  if (!mesh) return Forward(mesh);
  const auto reader = OpenInput(command_of_job, context, job.figures);
  if (!reader) return Forward(reader);
  auto kept = job.KeepCheckpoints(command.share, command.lattice);
  if (!kept) return kept;
  const SampleOptions& options = command_of_job.options;
  auto scanned = ScanMesh(**reader, options, command.share, command.lattice, context);
  if (!scanned) return tl::unexpected<Error>(Named(scanned.error(), command_of_job.input));
  return job.WritePartialFile(PartialOf(*scanned, options, command.share, *mesh), *scanned->store);
}

Result<void> RunMerge(const MergeCommand& command, RunContext& context) {
  SampleCommand whole = command.job;
  Job job(whole, context);
  if (auto ready = job.Prepare(PlacesOf(command)); !ready) return ready;
  auto combined = Combine(command, context);
  if (!combined) return Forward(combined);
  for (const std::string& name : combined->left_out) {
    if (!whole.quiet) std::fprintf(stderr, "strata: %s: left out, given already\n", name.c_str());
  }
  const PartialInfo& info = combined->info;
  if (command.to_partial) return job.WritePartialFile(info, *combined->store);
  if ((whole.options.attributes & kBarycentric) != 0 && !info.barycentric) {
    return Fail(ErrorCode::kInvalidArgument,
                "--attributes barycentric was not asked for when the shares were scanned");
  }
  whole.options.lattice = info.spec;
  whole.options.lambda = info.lambda;
  whole.options.seed = info.seed;
  whole.options.integrator = info.integrator;
  const std::vector<Partial> parts = std::move(combined->parts);
  auto scanned = WholeOf(std::move(*combined));
  if (!scanned) return Forward(scanned);
  if (command.region) {
    return job.DeliverRegion({whole, *command.region, parts}, std::move(*scanned));
  }
  auto sampled = GatherSamples(std::move(*scanned), OptionsForOutput(whole), context);
  if (!sampled) return Forward(sampled);
  return job.Deliver(std::move(*sampled));
}

Result<void> RunSample(const SampleCommand& command, RunContext& context, JobReport* report) {
  Job job(command, context);
  if (auto ready = job.Prepare(PlacesOf(command)); !ready) return ready;
  if (auto kept = job.KeepCheckpoints({}, {}); !kept) return kept;
  const auto reader = OpenInput(command, context, job.figures);
  if (!reader) return Forward(reader);
  auto sampled = Sample(command, **reader, context, job.figures);
  if (!sampled) return Forward(sampled);
  return job.Deliver(std::move(*sampled), report);
}

}  // namespace strata::server
