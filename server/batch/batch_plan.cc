#include "server/batch/batch_plan.h"

#include <algorithm>
#include <cmath>
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
  std::ifstream file(name, std::ios::binary);
  if (!file) return Fail(ErrorCode::kNotFound, name + ": cannot be opened");
  text << file.rdbuf();
  if (file.bad()) return Fail(ErrorCode::kIo, name + ": cannot be read");
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
    if (Takes(filter, path)) models.push_back(**std::move(found));
  }
  return models;
}

/// Failures that will come again as long as the bytes and the options are the same.
bool WillFailAgain(const std::string& type) {
  return type == "invalid-argument" || type == "corrupt-input" || type == "unsupported-format" ||
         type == "empty-surface";
}

/// Looks models up in what former batches left.
class Former {
 public:
  Former(OutputPlace& outputs, Manifest& manifest, const std::vector<ManifestReader>& others)
      : outputs_(outputs), manifest_(manifest), others_(others) {}

  /// The line of a model that was sampled with these options by this version and whose output is
  /// there; or of one that failed and will again. Whether its bytes are the same is still open.
  Result<std::optional<ManifestLine>> Find(const ModelEntry& model, const ModelOptions& options) {
    bool elsewhere = false;
    auto line = manifest_.Find(model.path);
    for (std::size_t i = 0; line && !*line && i < others_.size(); ++i) {
      line = others_[i].Find(model.path);
      elsewhere = line && line->has_value();
    }
    if (!line || !*line) return line;
    const ManifestLine& found = **line;
    if (found.version != kVersion || found.options != options.json) {
      return std::optional<ManifestLine>();
    }
    if (!found.sampled && !WillFailAgain(found.error_type)) return std::optional<ManifestLine>();
    if (found.sampled) {
      const auto there = outputs_.IsThere(found.output, found.output_bytes);
      if (!there) return Forward(there);
      if (!*there) return std::optional<ManifestLine>();
    }
    if (elsewhere) {
      if (auto copied = manifest_.Append(found); !copied) return Forward(copied);
    }
    return line;
  }

 private:
  OutputPlace& outputs_;
  Manifest& manifest_;
  const std::vector<ManifestReader>& others_;
};

std::string PictureName(const std::string& path) {
  return ".strata/pictures/" + io::Sha256Hex(path).substr(0, 32) + ".png";
}

/// Whether the i-th of `count` models is one of `pictures`, evenly spread.
bool IsShown(std::size_t i, std::size_t count, std::size_t pictures) {
  if (pictures >= count) return true;
  return (i + 1) * pictures / count != i * pictures / count;
}

Result<void> PlanModel(const BatchCommand& command, std::size_t index, Former& former,
                       BatchPlan& plan) {
  const ModelEntry& model = plan.models[index];
  const auto options = plan.options->Of(model.path);
  if (!options) return Forward(options);
  BatchTask task;
  task.model = &model;
  task.options = *options;
  if (!command.force) {
    const auto line = former.Find(model, **options);
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

Result<BatchPlan> PlanBatch(const BatchCommand& command, ModelSource& source, OutputPlace& outputs,
                            Manifest& manifest, const std::vector<ManifestReader>& others) {
  auto models = command.list ? Listed(command, source) : source.List(command.filter);
  if (!models) return Forward(models);
  BatchPlan plan;
  plan.models = *std::move(models);
  std::erase_if(plan.models,
                [&](const ModelEntry& model) { return !InShare(model.path, command.share); });
  std::ranges::sort(plan.models, {}, &ModelEntry::path);
  plan.options = std::make_unique<ModelOptionsFinder>(source, command.options);
  plan.tally.models = plan.models.size();
  Former former(outputs, manifest, others);
  for (std::size_t i = 0; i < plan.models.size(); ++i) {
    if (auto planned = PlanModel(command, i, former, plan); !planned) return Forward(planned);
  }
  return plan;
}

}  // namespace strata::server
