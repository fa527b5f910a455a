#include "server/batch/model_options.h"

#include <toml++/toml.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <utility>
#include <vector>

#include "server/command_line.h"
#include "server/nearest_name.h"
#include "server/option_table.h"
#include "server/service/canonical_options.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {

constexpr const char* kFileName = "strata.toml";
constexpr std::array kLatticeOptions = {"resolution", "voxel-size", "height"};

/// "-o,--output" → "output".
std::string LongName(std::string_view names) {
  return std::string(names.substr(names.find("--") + 2));
}

std::vector<std::string> ModelOptionNames() {
  std::vector<std::string> names;
  const auto add = [&names](std::string name) {
    if (IsModelOption(name)) names.push_back(std::move(name));
  };
  for (const OptionRow& row : SampleOptionRows()) add(LongName(row.names));
  for (const FlagRow& row : SampleFlagRows()) add(LongName(row.names));
  return names;
}

RawSample RawOf(const OptionTexts& texts) {
  RawSample raw;
  for (const OptionRow& row : SampleOptionRows()) {
    const auto found = texts.find(LongName(row.names));
    if (found != texts.end()) raw.*row.into = found->second;
  }
  raw.input = raw.output = "-";
  if (!raw.format) raw.format = Formats().front().name;
  return raw;
}

/// The message of the command line's own check, if there is something wrong.
Result<void> CheckTexts(const OptionTexts& texts) {
  const auto checked = CheckSample(RawOf(texts));
  if (!checked) return Forward(checked);
  return {};
}

std::optional<std::string> TextOf(const toml::node& node) {
  if (const auto* const text = node.as_string()) return text->get();
  if (const auto* const truth = node.as_boolean()) return truth->get() ? "true" : "false";
  if (const auto* const whole = node.as_integer()) return std::to_string(whole->get());
  if (const auto* const number = node.as_floating_point()) {
    std::array<char, 32> text;
    const auto end = std::to_chars(text.data(), text.data() + text.size(), number->get()).ptr;
    return std::string(text.data(), end);
  }
  return std::nullopt;
}

bool IsFlag(const std::string& name) {
  const auto named = [&name](const FlagRow& row) { return LongName(row.names) == name; };
  return std::ranges::any_of(SampleFlagRows(), named);
}

Result<std::string> CheckEntry(const std::string& name, const toml::node& node) {
  if (!IsModelOption(name)) {
    const std::string meant = NearestName(name, ModelOptionNames());
    return Fail(
        ErrorCode::kInvalidArgument,
        "unknown option '" + name + "'" +
            (meant.empty() ? "; those of `strata batch --help` that decide samples may stand here"
                           : "; did you mean '" + meant + "'?"));
  }
  const auto text = TextOf(node);
  const bool is_truth = text == "true" || text == "false";
  if (!text || IsFlag(name) != is_truth) {
    return Fail(ErrorCode::kInvalidArgument,
                name + ": expected " + (IsFlag(name) ? "true or false" : "a text or a number"));
  }
  if (auto good = CheckTexts({{name, *text}}); !good) return Forward(good);
  return *text;
}

/// The options of `far`, those of `near` before them.
OptionTexts Over(OptionTexts far, const OptionTexts& near) {
  const auto has = [&near](const char* name) { return near.contains(name); };
  if (std::ranges::any_of(kLatticeOptions, has)) {
    for (const char* const name : kLatticeOptions) far.erase(name);
  }
  for (const auto& [name, text] : near) far[name] = text;
  return far;
}

}  // namespace

bool IsModelOption(std::string_view name) {
  std::string field(name);
  std::ranges::replace(field, '-', '_');
  constexpr std::array kOfRun = {"threads", "memory", "batch_size"};
  return std::ranges::find(kOfRun, field) == kOfRun.end() &&
         v1::SampleOptions::descriptor()->FindFieldByName(field) != nullptr;
}

Result<OptionTexts> ParseOptionsFile(const std::string& text, const std::string& name) {
  OptionTexts texts;
  try {
    for (const auto& [key, node] : toml::parse(text, name)) {
      const std::string option(key.str());
      auto value = CheckEntry(option, node);
      if (!value) {
        return Fail(ErrorCode::kInvalidArgument, name + ", line " +
                                                     std::to_string(node.source().begin.line) +
                                                     ": " + value.error().message);
      }
      texts[option] = *std::move(value);
    }
  } catch (const toml::parse_error& error) {
    std::ostringstream message;
    message << name << ", line " << error.source().begin.line << ": " << error.description();
    return Fail(ErrorCode::kInvalidArgument, message.str());
  }
  if (auto good = CheckTexts(texts); !good) {
    return Fail(good.error().code, name + ": " + good.error().message);
  }
  return texts;
}

Result<ModelOptions> CheckModelOptions(const OptionTexts& texts) {
  if (auto good = CheckTexts(texts); !good) return Forward(good);
  const auto given = OptionsFromTexts({texts.begin(), texts.end()});
  if (!given) return Forward(given);
  auto canonical = Canonical(*given);
  if (!canonical) return Forward(canonical);
  ModelOptions options;
  options.json = nlohmann::ordered_json::parse(JsonOf(*canonical)).dump();
  options.suffix = '.' + canonical->format();
  options.options = *std::move(canonical);
  return options;
}

Result<const OptionTexts*> ModelOptionsFinder::TextsOf(const std::string& folder) {
  if (const auto known = folders_.find(folder); known != folders_.end()) return &known->second;
  OptionTexts texts;
  if (!folder.empty()) {
    const std::size_t slash = folder.rfind('/');
    const auto above = TextsOf(slash == folder.npos ? "" : folder.substr(0, slash));
    if (!above) return Forward(above);
    texts = **above;
  }
  const std::string path = folder.empty() ? kFileName : folder + '/' + kFileName;
  const auto text = source_.ReadText(path);
  if (!text) return Forward(text);
  if (*text) {
    const auto own = ParseOptionsFile(**text, source_.NameOf(path));
    if (!own) return Forward(own);
    texts = Over(std::move(texts), *own);
  }
  return &folders_.emplace(folder, std::move(texts)).first->second;
}

Result<const ModelOptions*> ModelOptionsFinder::Of(const std::string& path) {
  const std::size_t slash = path.rfind('/');
  const std::string folder = slash == path.npos ? "" : path.substr(0, slash);
  if (const auto known = of_folders_.find(folder); known != of_folders_.end()) return known->second;
  const auto texts = TextsOf(folder);
  if (!texts) return Forward(texts);
  OptionTexts all = Over(**texts, command_line_);
  auto& checked = checked_[all];
  if (!checked) {
    auto options = CheckModelOptions(all);
    if (!options) {
      const std::string where =
          source_.NameOf(folder.empty() ? kFileName : folder + '/' + kFileName);
      return Fail(options.error().code,
                  "the options of " + where + " and above: " + options.error().message);
    }
    checked = std::make_unique<ModelOptions>(*std::move(options));
  }
  return of_folders_[folder] = checked.get();
}

}  // namespace strata::server
