#include "server/service/wire_options.h"

#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

#include "server/nearest_name.h"
#include "server/option_table.h"

namespace strata::server {
namespace {

constexpr std::array<FormatName, 7> kFormats = {{
    {io::SampleFormat::kDraco, "drc", "model/vnd.draco"},
    {io::SampleFormat::kPly, "ply", "model/vnd.ply"},
    {io::SampleFormat::kXyz, "xyz", "text/plain"},
    {io::SampleFormat::kNpz, "npz", "application/x-npz"},
    {io::SampleFormat::kCsv, "csv", "text/csv"},
    {io::SampleFormat::kGlb, "glb", "model/gltf-binary"},
    {io::SampleFormat::kVdb, "vdb", "model/vnd.openvdb"},
}};

/// The shortest text that reads back as the same number.
template <class T>
std::string TextOf(T number) {
  std::array<char, 32> text;
  const auto written = std::to_chars(text.data(), text.data() + text.size(), number);
  return {text.data(), written.ptr};
}

bool IsNameCharacter(char c) { return (c >= 'a' && c <= 'z') || c == '-'; }

/// A message of the command line in the words of the wire: "--min-distance" is "min_distance".
std::string InWireWords(const std::string& message) {
  std::string text;
  for (std::size_t i = 0; i < message.size();) {
    const bool option = message.compare(i, 2, "--") == 0 && i + 2 < message.size() &&
                        IsNameCharacter(message[i + 2]) && (i == 0 || message[i - 1] == ' ');
    if (!option) {
      text += message[i++];
      continue;
    }
    for (i += 2; i < message.size() && IsNameCharacter(message[i]); ++i) {
      text += message[i] == '-' ? '_' : message[i];
    }
  }
  return text;
}

RawSample RawOf(const v1::SampleOptions& options) {
  RawSample raw;
  if (options.has_resolution()) raw.resolution = TextOf(options.resolution());
  if (options.has_voxel_size()) raw.voxel_size = TextOf(options.voxel_size());
  if (options.has_height()) raw.height = TextOf(options.height());
  if (options.has_method()) raw.method = options.method();
  if (options.has_count()) raw.count = TextOf(options.count());
  if (options.has_lambda()) raw.lambda = TextOf(options.lambda());
  if (options.has_min_distance()) raw.min_distance = TextOf(options.min_distance());
  if (options.has_seed()) raw.seed = TextOf(options.seed());
  if (options.has_integrator()) raw.integrator = options.integrator();
  raw.strict = options.strict();
  raw.format = options.has_format() ? options.format() : kFormats.front().name;
  if (options.has_attributes()) raw.attributes = options.attributes();
  if (options.has_normals()) raw.normals = options.normals();
  if (options.has_position_error()) raw.position_error = TextOf(options.position_error());
  if (options.has_tile_samples()) raw.tile_samples = TextOf(options.tile_samples());
  if (options.has_threads()) raw.threads = TextOf(options.threads());
  if (options.has_memory()) raw.memory = TextOf(options.memory());
  if (options.has_batch_size()) raw.batch_size = TextOf(options.batch_size());
  raw.quiet = true;
  return raw;
}

Result<SampleCommand> Check(RawSample raw, const std::string& input, const std::string& output) {
  raw.input = input;
  raw.output = output;
  auto checked = CheckSample(raw);
  if (!checked) return Fail(checked.error().code, InWireWords(checked.error().message));
  return checked;
}

std::vector<std::string> FieldNames() {
  std::vector<std::string> names;
  const auto* const descriptor = v1::SampleOptions::descriptor();
  for (int i = 0; i < descriptor->field_count(); ++i) names.push_back(descriptor->field(i)->name());
  return names;
}

Result<nlohmann::json> JsonOfTexts(const std::vector<std::pair<std::string, std::string>>& texts) {
  const std::vector<std::string> names = FieldNames();
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [typed, text] : texts) {
    std::string name = typed;
    std::ranges::replace(name, '-', '_');
    if (std::ranges::find(names, name) == names.end()) {
      const std::string meant = NearestName(name, names);
      return Fail(ErrorCode::kInvalidArgument,
                  "unknown option '" + typed + "'" +
                      (meant.empty() ? "" : "; did you mean '" + meant + "'?"));
    }
    if (json.contains(name)) {
      return Fail(ErrorCode::kInvalidArgument, name + ": given twice, expected once");
    }
    if (name == "strict" && (text == "true" || text == "false" || text.empty())) {
      json[name] = text != "false";  // ?strict is the flag --strict.
    } else {
      json[name] = text;
    }
  }
  return json;
}

/// The check's words for a text that the message's type cannot hold, which are better than the
/// parser's: they name range and default. Nothing if the check takes it.
Result<void> CheckTexts(const nlohmann::json& json) {
  RawSample raw;
  const auto take = [&json](const char* name, std::optional<std::string>& into) {
    if (json.contains(name) && json[name].is_string()) into = json[name].get<std::string>();
  };
  take("resolution", raw.resolution);
  take("voxel_size", raw.voxel_size);
  take("height", raw.height);
  take("method", raw.method);
  take("count", raw.count);
  take("lambda", raw.lambda);
  take("min_distance", raw.min_distance);
  take("seed", raw.seed);
  take("position_error", raw.position_error);
  take("tile_samples", raw.tile_samples);
  take("threads", raw.threads);
  take("batch_size", raw.batch_size);
  raw.format = kFormats.front().name;
  const auto checked = Check(raw, "-", "-");
  if (!checked) return Forward(checked);
  return {};
}

}  // namespace

Result<SampleCommand> CommandOf(const v1::SampleOptions& options, const std::string& input,
                                const std::string& output) {
  return Check(RawOf(options), input, output);
}

Result<v1::SampleOptions> OptionsFromTexts(
    const std::vector<std::pair<std::string, std::string>>& texts) {
  const auto json = JsonOfTexts(texts);
  if (!json) return Forward(json);
  v1::SampleOptions options;
  const auto parsed = google::protobuf::util::JsonStringToMessage(
      json->dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), &options);
  if (!parsed.ok()) {
    if (auto checked = CheckTexts(*json); !checked) return Forward(checked);
    return Fail(ErrorCode::kInvalidArgument, std::string(parsed.message()));
  }
  if (auto checked = CommandOf(options, "-", "-"); !checked) return Forward(checked);
  return options;
}

std::span<const FormatName> Formats() { return kFormats; }

const char* MediaTypeOf(io::SampleFormat format) {
  return std::ranges::find(kFormats, format, &FormatName::format)->media_type;
}

}  // namespace strata::server
