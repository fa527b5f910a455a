#include "server/batch/batch_config.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <map>
#include <memory>
#include <thread>

#include "server/batch/batch_option_table.h"
#include "server/memory.h"
#include "server/nearest_name.h"
#include "server/option_table.h"
#include "server/parse_number.h"

namespace strata::server {
namespace {

tl::unexpected<Error> Refuse(std::string message) {
  return Fail(ErrorCode::kInvalidArgument, std::move(message));
}

/// What was typed: long name → its texts; a flag's is "true".
using Typed = std::map<std::string, std::vector<std::string>>;

std::string LongName(std::string_view names) {
  return std::string(names.substr(names.find("--") + 2));
}

constexpr const char* kBatchSummary = "Samples every mesh below a folder or in a bucket.";
constexpr const char* kBatchUsage = "\nUsage: strata batch REPO -o OUT [options]\n";
constexpr const char* kReportSummary = "Says what the batches in these folders came to.";
constexpr const char* kReportUsage = "\nUsage: strata report OUT... [options]\n";
constexpr const char* kBatchFooter =
    "Examples:\n"
    "  strata batch models -o samples --resolution 256\n"
    "      every mesh below models; run again, it goes on or does what changed\n"
    "  strata batch models -o samples --include 'cars/**' --exclude '*.stl' --jobs 4\n"
    "  strata batch models -o samples --share $SLURM_ARRAY_TASK_ID/16\n"
    "  strata batch s3://bucket/models -o s3://bucket/samples\n"
    "      credentials from AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the profile\n"
    "      AWS_PROFILE of ~/.aws; another store than AWS's by AWS_ENDPOINT_URL\n"
    "  strata report samples\n\n"
    "A file strata.toml in a folder of REPO holds options for the models below it,\n"
    "`resolution = 256`; the nearest one wins, the command line before them all.\n\n"
    "Exit code 1: it has come to its end, and some models failed. Others:\n\n";

class HelpFormatter : public CLI::Formatter {
 public:
  explicit HelpFormatter(std::string usage) : usage_(std::move(usage)) {}
  std::string make_usage(const CLI::App*, std::string) const override { return usage_; }

 private:
  std::string usage_;
};

class Parser {
 public:
  Parser(const char* description, const char* name, const char* usage) : app_(description, name) {
    app_.set_help_flag("-h,--help", "Print this and stop.");
    auto formatter = std::make_shared<HelpFormatter>(usage);
    formatter->column_width(27);
    app_.formatter(formatter);
    app_.allow_extras();
  }

  void Add(const char* names, const char* value, const char* group, const char* help,
           bool repeated) {
    const std::string name = LongName(names);
    CLI::Option* option = nullptr;
    if (!value) {
      option = app_.add_flag_callback(
          names, [this, name] { typed_[name] = {"true"}; }, help);
    } else if (repeated) {
      option = app_.add_option_function<std::vector<std::string>>(
                       names, [this, name](const auto& texts) { typed_[name] = texts; }, help)
                   ->allow_extra_args(false);
    } else {
      option = app_.add_option_function<std::string>(
          names, [this, name](const std::string& text) { typed_[name] = {text}; }, help);
    }
    if (value) option->option_text(value);
    option->group(group);
  }
  void Add(std::span<const BatchOption> rows) {
    for (const BatchOption& row : rows)
      Add(row.names, row.value, row.group, row.help, row.repeated);
  }
  void SetFooter(std::string text) { app_.footer(std::move(text)); }

  /// The help, if it is asked for; what is no option goes to `places`.
  Result<std::optional<ShowText>> Parse(std::span<const std::string> arguments,
                                        std::vector<std::string>& places) {
    try {
      // CLI11 takes its vector back to front.
      app_.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
    } catch (const CLI::CallForHelp&) {
      return std::optional(ShowText{app_.help()});
    } catch (const CLI::Error& error) {
      return Refuse(std::string(error.what()) + "; see " + app_.get_name() + " --help");
    }
    const auto dashes = std::ranges::find(arguments, "--");
    for (const std::string& extra : app_.remaining()) {
      if (extra == "--") continue;
      const bool named = std::find(dashes, arguments.end(), extra) != arguments.end();
      if (extra.starts_with('-') && extra != "-" && !named) return Unknown(extra);
      places.push_back(extra);
    }
    return std::optional<ShowText>();
  }

  const Typed& typed() const { return typed_; }
  const CLI::App& app() const { return app_; }

 private:
  tl::unexpected<Error> Unknown(const std::string& extra) const {
    std::vector<std::string> names;
    for (const CLI::Option* option : app_.get_options()) {
      for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    }
    const std::string typed = extra.substr(0, extra.find('='));
    const std::string meant = NearestName(typed, names);
    return Refuse(
        "unknown option '" + typed + "'; " +
        (meant.empty() ? "see " + app_.get_name() + " --help" : "did you mean '" + meant + "'?"));
  }

  CLI::App app_;
  Typed typed_;
};

/// Reads checked values out of what was typed; keeps the first error.
class Values {
 public:
  explicit Values(const Typed& typed) : typed_(typed) {}

  bool Has(const std::string& name) const { return typed_.contains(name); }
  std::optional<std::string> Text(const std::string& name) const {
    const auto found = typed_.find(name);
    if (found == typed_.end()) return std::nullopt;
    return found->second.back();
  }
  std::vector<std::string> Texts(const std::string& name) const {
    const auto found = typed_.find(name);
    return found == typed_.end() ? std::vector<std::string>() : found->second;
  }
  void Number(const std::string& name, std::uint32_t min, std::uint32_t max, std::uint32_t& into) {
    const auto text = Text(name);
    if (!text || !outcome_) return;
    const std::string option = "--" + name;
    const std::string expected = "a whole number from " + std::to_string(min) + " to " +
                                 std::to_string(max) + " (default " + std::to_string(into) + ')';
    const auto value =
        ParseNumber<std::uint32_t>(*text, {option.c_str(), min, max, expected.c_str()});
    if (value) into = *value;
    if (!value) outcome_ = Forward(value);
  }
  void Require(bool holds, std::string message) {
    if (outcome_ && !holds) outcome_ = Refuse(std::move(message));
  }
  const Result<void>& outcome() const { return outcome_; }

 private:
  const Typed& typed_;
  Result<void> outcome_;
};

void ReadMemory(Values& values, BatchCommand& command) {
  command.memory_bytes = std::max(kLeastBatchMemory, UsableMemoryBytes() / 2);
  const auto text = values.Text("memory");
  if (!text) return;
  const auto bytes = ParseSize(*text);
  values.Require(bytes && *bytes >= kLeastBatchMemory,
                 "--memory: found '" + *text +
                     "', expected a size of 192M or more, such as 512M or 4G (default half of "
                     "what this process may use)");
  if (bytes) command.memory_bytes = *bytes;
}

void ReadBuckets(Values& values, BatchCommand& command) {
  command.s3_insecure = values.Has("s3-insecure");
  command.state = values.Text("state");
  values.Require(!command.state || !command.state->empty(), "--state: found no folder");
  const auto text = values.Text("fetch-ahead");
  if (!text) return;
  const auto bytes = ParseSize(*text);
  values.Require(bytes.has_value(), "--fetch-ahead: found '" + *text +
                                        "', expected a size such as 512M or 16G (default 4G)");
  if (bytes) command.fetch_ahead_bytes = *bytes;
}

void ReadShare(Values& values, BatchCommand& command) {
  const auto text = values.Text("share");
  if (!text) return;
  const std::size_t slash = std::min(text->find('/'), text->size());
  constexpr std::uint32_t kMost = 1u << 20;
  const auto index = ParseNumber<std::uint32_t>(text->substr(0, slash), {"", 0, kMost - 1, ""});
  const auto count = ParseNumber<std::uint32_t>(slash < text->size() ? text->substr(slash + 1) : "",
                                                {"", 1, kMost, ""});
  const bool good = index && count && *index < *count;
  values.Require(good, "--share: found '" + *text +
                           "', expected I/N with I from 0 to N-1 and N from 1 to 1048576");
  if (good) command.share = {*index, *count};
}

/// The samples' options, checked on their own, so that a message names them as they were typed.
void ReadSampleOptions(const Typed& typed, Values& values, BatchCommand& command) {
  for (const auto& [name, texts] : typed) {
    if (IsModelOption(name)) command.options[name] = texts.back();
  }
  const auto checked = CheckModelOptions(command.options);
  if (!checked) values.Require(false, checked.error().message);
}

Result<BatchCommand> CheckBatch(const Typed& typed, const std::vector<std::string>& places) {
  Values values(typed);
  BatchCommand command;
  values.Require(places.size() == 1 && !places.front().empty(),
                 places.size() > 1 ? "found a second REPO '" + places[1] + "', expected one"
                                   : "REPO is missing: the folder or bucket of the models");
  values.Require(!values.Text("output").value_or("").empty(), "-o OUT is missing");
  values.Require(!(values.Has("resume") && values.Has("force")),
                 "--resume and --force exclude each other");
  values.Require(!values.Has("null") || values.Has("list"), "--null needs --list");
  if (!places.empty()) command.repository = places.front();
  command.output = values.Text("output").value_or("");
  command.list = values.Text("list");
  command.list_ends_with_nul = values.Has("null");
  command.filter = {values.Texts("include"), values.Texts("exclude"), values.Has("all")};
  command.jobs = std::max(1u, std::thread::hardware_concurrency());
  values.Number("jobs", 1, 1024, command.jobs);
  values.Number("pictures", 0, 10'000, command.pictures);
  values.Number("timeout", 1, 1'000'000, command.timeout_seconds);
  values.Number("progress-interval", 1, 86'400, command.progress_seconds);
  ReadMemory(values, command);
  ReadBuckets(values, command);
  ReadShare(values, command);
  ReadSampleOptions(typed, values, command);
  command.scratch = values.Text("scratch");
  command.simd = values.Text("simd").value_or("auto");
  command.force = values.Has("force");
  command.prune = values.Has("prune");
  command.quiet = values.Has("quiet");
  if (!values.outcome()) return Forward(values.outcome());
  return command;
}

Result<ReportCommand> CheckReport(const Typed& typed, const std::vector<std::string>& places) {
  Values values(typed);
  ReportCommand command;
  values.Require(!places.empty(), "OUT is missing: the folder of a batch's outputs");
  values.Number("slowest", 0, 10'000, command.slowest);
  command.outputs = places;
  command.json = values.Has("json");
  command.s3_insecure = values.Has("s3-insecure");
  command.html = values.Text("html");
  const bool page = !values.Has("no-html") && !command.json;
  if (page && !command.html && !places.empty()) {
    command.html = places.front() + (places.front().ends_with('/') ? "" : "/") + "report.html";
  }
  if (!values.outcome()) return Forward(values.outcome());
  return command;
}

void AddBatch(Parser& parser) {
  parser.Add(BatchOptions());
  for (const OptionRow& row : SampleOptionRows()) {
    if (!IsModelOption(LongName(row.names))) continue;
    parser.Add(row.names, row.value, row.group, row.help, false);
  }
  for (const FlagRow& row : SampleFlagRows()) {
    if (!IsModelOption(LongName(row.names))) continue;
    parser.Add(row.names, nullptr, row.group, row.help, false);
  }
  parser.SetFooter(kBatchFooter + ExitCodesText());
}

void AddReport(Parser& parser) {
  parser.Add(ReportOptions());
  parser.SetFooter(ExitCodesText());
}

}  // namespace

Result<std::variant<BatchCommand, ShowText>> ParseBatch(std::span<const std::string> arguments) {
  Parser parser(kBatchSummary, "strata batch", kBatchUsage);
  AddBatch(parser);
  std::vector<std::string> places;
  const auto shown = parser.Parse(arguments, places);
  if (!shown) return Forward(shown);
  if (*shown) return std::variant<BatchCommand, ShowText>(**shown);
  auto command = CheckBatch(parser.typed(), places);
  if (!command) return Forward(command);
  return std::variant<BatchCommand, ShowText>(*std::move(command));
}

Result<std::variant<ReportCommand, ShowText>> ParseReport(std::span<const std::string> arguments) {
  Parser parser(kReportSummary, "strata report", kReportUsage);
  AddReport(parser);
  std::vector<std::string> places;
  const auto shown = parser.Parse(arguments, places);
  if (!shown) return Forward(shown);
  if (*shown) return std::variant<ReportCommand, ShowText>(**shown);
  auto command = CheckReport(parser.typed(), places);
  if (!command) return Forward(command);
  return std::variant<ReportCommand, ShowText>(*std::move(command));
}

std::vector<CommandText> DescribeBatchCommands() {
  Parser batch(kBatchSummary, "strata batch", kBatchUsage);
  AddBatch(batch);
  Parser report(kReportSummary, "strata report", kReportUsage);
  AddReport(report);
  return {Describe(batch.app(), "batch"), Describe(report.app(), "report")};
}

std::string ShareSuffix(const ModelShare& share) {
  if (share.count == 1) return "";
  return '-' + std::to_string(share.index) + "-of-" + std::to_string(share.count);
}

}  // namespace strata::server
