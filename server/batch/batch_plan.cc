#include "server/batch/batch_plan.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <sstream>
#include <utility>

#include "core/version.h"
#include "io/sha256.h"

namespace strata::server {
namespace {

constexpr double kLargeSeconds = 8;

Result<std::string> ReadList(const std::string& name) {
  std::ostringstream text;
  if (name == "-") {
    text << std::cin.rdbuf();
    return text.str();
  }
  std::error_code unknown;
  if (std::filesystem::is_directory(name, unknown)) {
    return Fail(ErrorCode::kInvalidArgument, name + ": found a folder, expected a list of models");
  }
  std::ifstream file(name, std::ios::binary);
  if (!file) return Fail(ErrorCode::kNotFound, name + ": cannot be opened");
  if (file.peek() != std::ifstream::traits_type::eof()) text << file.rdbuf();
  if (file.bad() || !text) return Fail(ErrorCode::kIo, name + ": cannot be read");
  return text.str();
}

/// The paths of a list, each once. A path may stand as it is below the place, or with "./" before
/// it.
std::vector<std::string> PathsOf(const std::string& text, char end) {
  std::vector<std::string> paths;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line, end);) {
    if (end == '\n' && line.ends_with('\r')) line.pop_back();
    while (line.starts_with("./")) line.erase(0, 2);
    if (!line.empty()) paths.push_back(line);
  }
  std::ranges::sort(paths);
  paths.erase(std::unique(paths.begin(), paths.end()), paths.end());
  return paths;
}

/// A model that a list names and that is not there is an error: a typing mistake would go unseen.
Result<std::vector<ModelEntry>> Listed(const BatchCommand& command, ModelSource& source) {
  const auto text = ReadList(*command.list);
  if (!text) return Forward(text);
  ModelFilter filter = command.filter;
  filter.all = true;
  std::vector<ModelEntry> models;
  for (const std::string& path : PathsOf(*text, command.list_ends_with_nul ? '\0' : '\n')) {
    auto found = source.Find(path);
    if (!found) return Forward(found);
    if (!*found) {
      return Fail(ErrorCode::kNotFound,
                  source.NameOf(path) + ": no such model; " + *command.list + " names it");
    }
    if (IsHidden(path)) {
      return Fail(
          ErrorCode::kInvalidArgument,
          source.NameOf(path) + ": hidden files are no models; " + *command.list + " names it");
    }
    if (Takes(filter, path)) models.push_back(**std::move(found));
  }
  return models;
}

/// Failures that will come again as long as the bytes and the options are the same.
bool WillFailAgain(const std::string& type) {
  return type == "invalid-argument" || type == "corrupt-input" || type == "unsupported-format" ||
         type == "empty-surface";
}

/// Whether a line says what this version would say of a model with these options, but for its
/// bytes: it was sampled and its output is there, or it failed and will again.
Result<bool> StillHolds(const ManifestLine& line, const ModelOptions& options,
                        OutputPlace& outputs) {
  if (line.version != kVersion || line.options != options.json) return false;
  if (!line.sampled) return WillFailAgain(line.error_type);
  return outputs.IsThere(line.output, line.output_bytes);
}

/// Whether the files that the model's mesh asked for are as they were.
Result<bool> CompanionsHold(const ManifestLine& line, ModelSource& source) {
  const std::string folder = line.path.substr(0, line.path.rfind('/') + 1);
  for (const CompanionEntry& companion : line.companions) {
    const auto now = source.Find(folder + companion.path);
    if (!now) return Forward(now);
    const bool same = *now ? (*now)->stamp == companion.stamp && (*now)->size == companion.size
                           : companion.stamp.empty();
    if (!same) return false;
  }
  return true;
}

/// The line of a model that need not be sampled again, unless its bytes have changed. One of
/// another share is copied.
Result<std::optional<ManifestLine>> FindDone(const ModelEntry& model, const ModelOptions& options,
                                             const PlanPlaces& places) {
  const auto lines = places.former.Of(model.path);
  if (!lines) return Forward(lines);
  for (const ManifestLine& line : *lines) {
    const auto holds = StillHolds(line, options, places.outputs);
    if (!holds) return Forward(holds);
    if (!*holds || (line.sampled && IsOverruled(line, *lines))) continue;
    const auto companions = CompanionsHold(line, places.source);
    if (!companions) return Forward(companions);
    if (!*companions) continue;
    const auto own = places.manifest.Find(model.path);
    if (!own) return Forward(own);
    if (!*own || (*own)->measured.finished != line.measured.finished) {
      if (auto copied = places.manifest.Append(line); !copied) return Forward(copied);
    }
    return std::optional(line);
  }
  return std::optional<ManifestLine>();
}

std::string PictureName(const std::string& path) {
  return ".strata/pictures/" + io::Sha256Hex(path).substr(0, 32) + ".png";
}

/// Whether the i-th of `count` models is one of `pictures`, evenly spread.
bool IsShown(std::size_t i, std::size_t count, std::size_t pictures) {
  if (pictures >= count) return true;
  return (i + 1) * pictures / count != i * pictures / count;
}

Result<void> PlanModel(const BatchCommand& command, std::size_t index, const PlanPlaces& places,
                       BatchPlan& plan) {
  const ModelEntry& model = plan.models[index];
  const auto options = plan.options->Of(model.path);
  if (!options) return Forward(options);
  BatchTask task;
  task.model = &model;
  task.options = *options;
  if (!command.force) {
    const auto line = FindDone(model, **options, places);
    if (!line) return Forward(line);
    if (*line && (*line)->stamp == model.stamp && (*line)->input_bytes == model.size) {
      ++((*line)->sampled ? plan.tally.skipped : plan.tally.kept_failed);
      if (!(*line)->sampled) ++plan.tally.reasons[(*line)->error_type];
      return {};
    }
    if (*line) task.known_sha256 = (*line)->input_sha256;
  }
  if (IsShown(index, plan.models.size(), command.pictures)) task.picture = PictureName(model.path);
  task.cost = CostOf(model, (*options)->options);
  task.whole_machine = task.cost > kLargeSeconds && command.jobs > 1;
  plan.cost += task.cost;
  plan.tasks.push_back(std::move(task));
  return {};
}

}  // namespace

bool InShare(const std::string& path, const ModelShare& share) {
  if (share.count == 1) return true;
  const std::string hash = io::Sha256Hex(path).substr(0, 15);
  return std::stoull(hash, nullptr, 16) % share.count == share.index;
}

double CostOf(const ModelEntry& model, const v1::SampleOptions& options) {
  const std::string_view path = model.path;
  const bool packed = path.ends_with(".gz") || path.ends_with(".zst") || path.ends_with(".zstd");
  const double bytes = static_cast<double>(model.size) * (packed ? 4 : 1);
  double cells = 0;  // Of a surface that fills the lattice about as a cube's would.
  if (options.has_resolution()) cells = 3 * std::pow(options.resolution(), 2);
  if (options.has_height()) cells = 3 * std::pow(2, 2 * (options.height() - 1));
  // A surface of few triangles has its cells all the same, but no more than it has been seen to.
  return 1e-3 + bytes / 40e6 + std::min(cells, 1e9) / 1e6;
}

Result<BatchPlan> PlanBatch(const BatchCommand& command, const PlanPlaces& places) {
  auto models = command.list ? Listed(command, places.source) : places.source.List(command.filter);
  if (!models) return Forward(models);
  BatchPlan plan;
  plan.models = *std::move(models);
  std::erase_if(plan.models,
                [&](const ModelEntry& model) { return !InShare(model.path, command.share); });
  std::ranges::sort(plan.models, {}, &ModelEntry::path);
  plan.options = std::make_unique<ModelOptionsFinder>(places.source, command.options);
  plan.tally.models = plan.models.size();
  for (std::size_t i = 0; i < plan.models.size(); ++i) {
    if (auto planned = PlanModel(command, i, places, plan); !planned) return Forward(planned);
  }
  return plan;
}

}  // namespace strata::server
