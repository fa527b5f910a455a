// The options of each model of a batch: its folders' strata.toml, and the command line over all.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <string_view>

#include "core/result.h"
#include "server/batch/places.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// Long name without dashes → text as on the command line; of a flag "true" or "false".
using OptionTexts = std::map<std::string, std::string>;

/// Options, checked and in their canonical form.
struct ModelOptions {
  v1::SampleOptions options;
  std::string json;    ///< On one line; equal options, equal texts.
  std::string suffix;  ///< Of the output: ".drc".
};

/// Whether a model may have an option of its own: all that decide its samples and its output.
bool IsModelOption(std::string_view name);

/// The options in the text of a strata.toml that messages call `name`.
/// Errors: kInvalidArgument, naming file and line.
Result<OptionTexts> ParseOptionsFile(const std::string& text, const std::string& name);

/// Options from texts. Errors: kInvalidArgument.
Result<ModelOptions> CheckModelOptions(const OptionTexts& texts);

/// What each model's options are. For every option the nearest strata.toml from the model's folder
/// up to the place's root decides, and the command line before them all; --resolution, --voxel-size
/// and
/// --height are one option. Each file is read once. Threads: one at a time.
class ModelOptionsFinder {
 public:
  /// `source` must outlive it.
  ModelOptionsFinder(ModelSource& source, OptionTexts command_line)
      : source_(source), command_line_(std::move(command_line)) {}

  /// As long as this lives. Errors: kInvalidArgument, kIo, kOverBudget, naming the file.
  Result<const ModelOptions*> Of(const std::string& path);

 private:
  Result<const OptionTexts*> TextsOf(const std::string& folder);

  ModelSource& source_;
  const OptionTexts command_line_;
  std::map<std::string, OptionTexts> folders_;
  std::map<std::string, const ModelOptions*> of_folders_;
  std::map<OptionTexts, std::unique_ptr<ModelOptions>> checked_;
};

}  // namespace strata::server
